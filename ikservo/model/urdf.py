"""Read a URDF (links, joints, mesh paths), check its tree, and warn about common mistakes."""

from __future__ import annotations

import contextlib
import difflib
import math
import posixpath
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote, urlsplit

from ikservo.errors import FileFormatError
from ikservo.files.reading import path_inside, quote, read_text
from ikservo.model.urdf_types import (
    Box,
    Cylinder,
    Mesh,
    Shape,
    Sphere,
    Triple,
    Urdf,
    UrdfJoint,
    UrdfJointType,
    UrdfLink,
    UrdfMimic,
)
from ikservo.model.urdf_xml import (
    MAX_URDF_BYTES,
    XmlElement,
    import_command,
    parse_origin,
    parse_xml,
)

_MIN_AXIS_LENGTH = 1e-6
_PACKAGE, _FILE = "package://", "file://"


class _LimitTag(NamedTuple):
    lower: float
    upper: float
    effort: float
    velocity: float


def parse_joint(element: XmlElement) -> UrdfJoint:
    """Parse one joint; `find_root` checks later that its links and the mimicked joint exist."""
    name, text = element.name(), element.text("type")
    kinds = {kind.value: kind for kind in UrdfJointType}
    if text not in kinds:
        found = f"joint {quote(name)} is of type {quote(text)}"
        raise element.error(found, f"one of {', '.join(kinds)}")
    kind = kinds[text]
    xyz_m, rpy_rad = parse_origin(element)
    limits = _read_limits(element, kind, name)
    parent, child = (element.required(role).name("link") for role in ("parent", "child"))
    axis = _read_axis(element, kind)
    mimic, follows = element.optional("mimic"), None
    if mimic is not None:
        leader, multiplier = mimic.name("joint"), mimic.number("multiplier", 1.0)
        follows = UrdfMimic(leader, multiplier, mimic.number("offset", 0.0))
    return UrdfJoint(
        name=name,
        kind=kind,
        parent=parent,
        child=child,
        xyz_m=xyz_m,
        rpy_rad=rpy_rad,
        axis=axis,
        lower=limits.lower,
        upper=limits.upper,
        effort=limits.effort,
        velocity=limits.velocity,
        mimic=follows,
        line=element.line,
    )


def _read_axis(element: XmlElement, kind: UrdfJointType) -> Triple:
    axis = element.optional("axis")
    if axis is None:
        return (1.0, 0.0, 0.0)
    x, y, z = axis.vector("xyz", most=math.inf)  # only the direction of the axis counts
    if not kind.is_movable:  # exporters write 0 0 0 here, without a meaning
        return (1.0, 0.0, 0.0)
    largest = max(abs(x), abs(y), abs(z))
    if largest < _MIN_AXIS_LENGTH:
        found = f"joint {quote(element.name())} moves about an axis of zero length"
        raise axis.error(found, 'a direction, such as xyz="0 0 1"')
    x, y, z = x / largest, y / largest, z / largest  # scaled before squaring, to avoid an overflow
    length = math.hypot(x, y, z)
    return (x / length, y / length, z / length)


def _read_limits(element: XmlElement, kind: UrdfJointType, name: str) -> _LimitTag:
    if kind is UrdfJointType.FIXED:
        return _LimitTag(0.0, 0.0, math.inf, math.inf)
    if kind is UrdfJointType.CONTINUOUS:
        limit = element.optional("limit")
        lower, upper = -math.inf, math.inf
    else:
        limit = element.required("limit")
        lower, upper = limit.number("lower", 0.0), limit.number("upper", 0.0)
        if lower > upper:
            found = f"joint {quote(name)} has lower {lower:g} above upper {upper:g}"
            raise limit.error(found, "lower below upper")
        if lower == upper:
            found = f"joint {quote(name)} has lower = upper = {lower:g}, so it cannot move"
            raise limit.error(found, 'its real range, or type="fixed"')
    if limit is None:
        return _LimitTag(lower, upper, math.inf, math.inf)
    return _LimitTag(
        lower, upper, _parse_strength(limit, "effort"), _parse_strength(limit, "velocity")
    )


def _parse_strength(limit: XmlElement, attribute: str) -> float:
    if attribute not in limit.attributes:
        return math.inf
    value = limit.number(attribute, most=math.inf)  # some files write 1e10 for "no limit"
    if value < 0.0:
        raise limit.error(f"has {attribute} {value:g}", "a number above 0, or no such attribute")
    return value


_SHAPES = ("box", "cylinder", "sphere", "mesh")
_NO_INERTIA = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


FindMesh = Callable[[str], Path | None]
"""Function that returns the file for a mesh's name, or None if the mesh cannot be used."""


def parse_link(
    element: XmlElement, find_mesh: FindMesh, materials: Mapping[str, Triple] | None = None
) -> UrdfLink:
    """Parse a ``<link>``; the robot's materials are colours by name."""
    name = element.name()
    collisions = tuple(_read_shape(each, find_mesh) for each in element.child_elements("collision"))
    drawn = element.child_elements("visual")
    visuals = tuple(_read_shape(each, find_mesh) for each in drawn)
    colours = tuple(_find_colour(each, materials or {}) for each in drawn)
    com_m = rpy_rad = (0.0, 0.0, 0.0)
    mass_kg, inertia = 0.0, _NO_INERTIA
    inertial = element.optional("inertial")
    if inertial is not None:
        com_m, rpy_rad = parse_origin(inertial)
        mass = inertial.required("mass")
        mass_kg = mass.number("value")
        if mass_kg < 0:
            raise mass.error(f"a mass of {mass_kg:g} kg", "zero or more")
        moments = inertial.optional("inertia")
        if moments is not None:
            ixx, ixy, ixz = (moments.number(key, 0.0) for key in ("ixx", "ixy", "ixz"))
            iyy, iyz, izz = (moments.number(key, 0.0) for key in ("iyy", "iyz", "izz"))
            inertia = ixx, ixy, ixz, iyy, iyz, izz
            if min(ixx, iyy, izz) < 0:
                found = f"an inertia of {min(ixx, iyy, izz):g} kg m²"
                raise moments.error(found, "ixx, iyy and izz of zero or more")
    return UrdfLink(
        name, mass_kg, com_m, rpy_rad, inertia, collisions, visuals, element.line, colours
    )


def _find_colour(visual: XmlElement, materials: Mapping[str, Triple]) -> Triple | None:
    """Return a visual shape's colour, from its own material or from the material that it names."""
    for material in visual.child_elements("material"):
        named = materials.get(material.attributes.get("name", ""))
        return named if (own := _read_colour(material)) is None else own
    return None


def _read_colour(material: XmlElement) -> Triple | None:
    """Read red, green and blue; return None if they are not usable, because they are optional."""
    for colour in material.child_elements("color"):
        parts = colour.attributes.get("rgba", "").split()
        with contextlib.suppress(ValueError):
            r, g, b, _ = (min(max(float(part), 0.0), 1.0) for part in parts)
            return (r, g, b) if math.isfinite(r + g + b) else None
    return None


def _read_shape(element: XmlElement, find_mesh: FindMesh) -> Shape:
    xyz_m, rpy_rad = parse_origin(element)
    geometry = element.required("geometry")
    if len(geometry.children) != 1 or geometry.children[0].tag not in _SHAPES:
        tags = ", ".join(f"<{child.tag}>" for child in geometry.children[:3]) or "nothing"
        raise geometry.error(f"<geometry> holds {tags}", f"one of {', '.join(_SHAPES)}")
    shape = geometry.children[0]
    match shape.tag:
        case "box":
            size_m = _positive_vector(shape, "size", shape.vector("size"))
            return Box(size_m, xyz_m, rpy_rad)
        case "cylinder":
            return Cylinder(
                _positive_length(shape, "radius"), _positive_length(shape, "length"), xyz_m, rpy_rad
            )
        case "sphere":
            return Sphere(_positive_length(shape, "radius"), xyz_m, rpy_rad)
        case _:
            filename, scale = shape.text("filename"), shape.vector("scale", default=1.0)
            return Mesh(filename, find_mesh(filename), scale, xyz_m, rpy_rad)


def _positive_length(shape: XmlElement, attribute: str) -> float:
    length_m = shape.number(attribute)
    _positive_vector(shape, attribute, (length_m, 1.0, 1.0))
    return length_m


def _positive_vector(shape: XmlElement, attribute: str, size_m: Triple) -> Triple:
    if min(size_m) <= 0:
        found = f"<{shape.tag}> has {attribute}={quote(shape.text(attribute))}"
        raise shape.error(found, "more than zero metres")
    return size_m


_Part = UrdfLink | UrdfJoint


def find_root(path: Path, links: Sequence[UrdfLink], joints: Sequence[UrdfJoint]) -> str:
    """Return the name of the only link that is not the child of a joint.

    Raises:
        FileFormatError: Names occur twice, links are missing, or the links do not form one tree.
    """
    if not links:
        raise FileFormatError(path, "", "the robot has no links", "at least one <link>")
    _check_unique_names(path, "link", links)
    _check_unique_names(path, "joint", joints)
    _check_link_names(path, {link.name for link in links}, joints)
    leaders = {joint.name for joint in joints if joint.kind.is_movable and joint.mimic is None}
    for joint in joints:
        if joint.mimic is not None and joint.mimic.joint not in leaders:
            followed = quote(joint.mimic.joint)
            found = f"joint {quote(joint.name)} mimics {followed}, which cannot be mimicked"
            raise _tree_error(path, joint, found, "a joint that moves and mimics no other")
    carriers: dict[str, UrdfJoint] = {}
    for joint in joints:
        other = carriers.setdefault(joint.child, joint)
        if other is not joint:
            found = f"joint {quote(joint.name)} has the child {quote(joint.child)}"
            already = f"which is already the child of {quote(other.name)} in line {other.line}"
            raise _tree_error(path, joint, f"{found}, {already}", "one parent for each link")
    _check_acyclic(path, carriers)
    roots = [link for link in links if link.name not in carriers]
    if len(roots) > 1:
        both = f"neither link {quote(roots[0].name)} nor {quote(roots[1].name)}"
        found = f"{both} is the child of a joint"
        raise _tree_error(path, roots[1], found, "exactly one root link")
    return roots[0].name


def _tree_error(path: Path, part: _Part, found: str, expected: str) -> FileFormatError:
    return FileFormatError(path, f"line {part.line}", found, expected)


def _check_unique_names(path: Path, kind: str, parts: Sequence[_Part]) -> None:
    lines: dict[str, int] = {}
    for part in parts:
        if part.name in lines:
            found = f"{kind} {quote(part.name)} is already defined in line {lines[part.name]}"
            raise _tree_error(path, part, found, "each name once")
        lines[part.name] = part.line


def _check_link_names(path: Path, names: Collection[str], joints: Sequence[UrdfJoint]) -> None:
    for joint in joints:
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in names:
                found = (
                    f"joint {quote(joint.name)} has the {role} {quote(link)}, which is not a link"
                )
                close = difflib.get_close_matches(link, names, n=1)
                expected = "the name of a <link>"
                if close:
                    expected += f", perhaps {quote(close[0])}"
                raise _tree_error(path, joint, found, expected)


def _check_acyclic(path: Path, carriers: Mapping[str, UrdfJoint]) -> None:
    grounded: set[str] = set()
    for start in carriers:
        trail: dict[str, UrdfJoint] = {}
        at = start
        while at in carriers and at not in grounded:
            if at in trail:
                found = f"joint {quote(carriers[at].name)} closes a cycle of links"
                raise _tree_error(path, carriers[at], found, "a tree without cycles")
            trail[at] = carriers[at]
            at = carriers[at].parent
        grounded.update(trail)


# A little more than a revolution, because some arms round 2*pi up.
_FULL_TURN_RAD = 2 * math.pi + 1e-3


def lint_urdf(
    root: XmlElement, links: Sequence[UrdfLink], joints: Sequence[UrdfJoint]
) -> tuple[str, ...]:
    """Return one line for each value that is allowed but probably a mistake."""
    found: list[str] = []
    for joint in joints:
        place = f"line {joint.line}: joint {quote(joint.name)}"
        for side, value in (("lower", joint.lower), ("upper", joint.upper)):
            if joint.kind is UrdfJointType.REVOLUTE and abs(value) > _FULL_TURN_RAD:
                hint = _in_degrees_hint(value)
                found.append(f"{place} has {side} {value:g} rad, more than a turn; {hint}")
        for value in joint.rpy_rad:
            if abs(value) > _FULL_TURN_RAD:
                found.append(f"{place} has {value:g} rad in its rpy; {_in_degrees_hint(value)}")

    for element in root.child_elements("joint"):
        limit = element.optional("limit")
        continuous = element.text("type") == UrdfJointType.CONTINUOUS.value
        if continuous and limit and {"lower", "upper"} & limit.attributes.keys():
            place = f"line {limit.line}: joint {quote(element.name())}"
            keep = 'type="revolute" keeps them'
            found.append(f"{place} is continuous and ignores its limits; {keep}")
    shapes = [shape for link in links for shape in (*link.collisions, *link.visuals)]
    outside = [shape for shape in shapes if isinstance(shape, Mesh) and shape.path is None]
    if outside:
        first = f"{len(outside)} in all, the first is {quote(outside[0].filename)}"
        found.append(f"meshes outside the model's folder cannot be used: {first}")
    return tuple(found)


def _in_degrees_hint(value: float) -> str:
    return f"if these are degrees, write {math.radians(value):.6g}"


_XACRO = "xacro}"  # end of the namespace; files differ in its beginning


def read_urdf(path: Path | str, folder: Path | None = None) -> Urdf:
    """Read the links, joints and simple shapes of a URDF; anything else in it is ignored.

    Only the file itself is opened: no meshes, no includes, no document types.

    Args:
        path: The file.
        folder: The folder of its meshes; None uses the folder of the file.

    Source: the URDF XML specification, http://wiki.ros.org/urdf/XML

    Raises:
        FileFormatError: The file cannot be read or is not a usable URDF; ``where`` is the line.
    """
    path = Path(path)
    root = parse_xml(path, read_urdf_text(path))
    macros = [child for child in root.children if _XACRO in child.tag]
    if macros:
        expected = f"a plain URDF; convert it once: {import_command(root.path)}"
        raise macros[0].error("the macros are not expanded", expected)
    home = path.parent if folder is None else folder
    return urdf_from_xml(root, lambda name: resolve_mesh_path(name, path, home))


def urdf_from_xml(root: XmlElement, find_mesh: FindMesh) -> Urdf:
    """Read a URDF from its outermost element.

    Raises:
        FileFormatError: The element is not a usable URDF; ``where`` is the line.
    """
    if root.tag != "robot":
        raise root.error(f"the outermost element is <{root.tag}>", "<robot>, as in a URDF")
    colours = {
        each.attributes.get("name", ""): _read_colour(each)
        for each in root.child_elements("material")
    }
    materials = {name: colour for name, colour in colours.items() if colour is not None}
    links = tuple(parse_link(each, find_mesh, materials) for each in root.child_elements("link"))
    joints = tuple(parse_joint(each) for each in root.child_elements("joint"))
    base = find_root(root.path, links, joints)
    name = root.name() if root.attributes.get("name") else ""
    return Urdf(name, links, joints, base, lint_urdf(root, links, joints))


def read_urdf_text(path: Path) -> str:
    """Read the text of a URDF.

    Raises:
        FileFormatError: The file cannot be read, or is a xacro, which is never run here.
    """
    if path.suffix == ".xacro":
        found = "has macros, and expanding them can run code from the file"
        expected = f"a plain URDF; if you trust the file: {import_command(path)}"
        raise FileFormatError(path, "", found, expected)
    return read_text(path, MAX_URDF_BYTES)


def resolve_mesh_path(filename: str, urdf: Path, folder: Path) -> Path | None:
    """Return the file to which a mesh's name refers if it is in the model's folder, else None.

    A relative name is resolved from the URDF. ``package://NAME/REST`` is REST or NAME/REST, in the
    model's folder or in the URDF's. ``file://`` is an absolute path. The name itself is checked
    first, so that nothing outside is read.
    """
    if filename.startswith(_PACKAGE):
        name = filename.removeprefix(_PACKAGE)
        package, _, rest = name.partition("/")
        if package in ("", ".", ".."):
            return None
        folders = (folder, urdf.parent)
        found = [path_inside(each, part) for each in folders for part in (name, rest)]
        inside = [path for path in found if path is not None]
        return next((path for path in inside if path.is_file()), inside[1] if inside[1:] else None)
    home = folder.resolve()
    if filename.startswith(_FILE):
        parts = urlsplit(filename)
        path = posixpath.normpath(unquote(parts.path))
        for base in (home, folder.absolute()) if parts.netloc in ("", "localhost") else ():
            if path.startswith(f"{base.as_posix()}/"):
                return path_inside(home, posixpath.relpath(path, base.as_posix()))
        return None
    beside = path_inside(urdf.parent, filename)
    place = urdf.parent.resolve()
    if beside or not filename.startswith("../") or not place.is_relative_to(home):
        return beside
    # The name leads out of the URDF's folder, perhaps to another subfolder of the model.
    name = posixpath.normpath(posixpath.join(place.relative_to(home).as_posix(), filename))
    return path_inside(home, name)
