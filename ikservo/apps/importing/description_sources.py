"""Read foreign descriptions (URDF, xacro, MJCF) as one tree of links and joints."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from ikservo.apps.importing.mjcf import read_mjcf
from ikservo.apps.importing.packages import PackageFolders
from ikservo.apps.importing.xacro import expand_xacro, needs_xacro
from ikservo.errors import FileFormatError, InputError
from ikservo.files.reading import quote, read_text
from ikservo.model.model_loading import check_size
from ikservo.model.urdf import urdf_from_xml
from ikservo.model.urdf_types import Urdf
from ikservo.model.urdf_xml import MAX_URDF_BYTES, XmlElement, is_mjcf, parse_xml

_MAX_FILES, _MAX_SHOWN = 20_000, 12
_HEAD_BYTES = 64 * 1024


@dataclass(slots=True)
class Description:
    """A robot description that has been read.

    Attributes:
        path: The file.
        urdf: The robot's links and joints.
        packages: The packages that it uses, as far as they were found.
        notes: The changes that made it a tree of joints that servos can drive.
    """

    path: Path
    urdf: Urdf
    packages: PackageFolders
    notes: list[str] = field(default_factory=list[str])


def choose_description(source: Path, name: str | None = None) -> Path:
    """Choose the description: a file, or the only file in a folder whose path ends in ``name``.

    Raises:
        InputError: There is no such file, or there are several; the message lists them.
    """
    if not source.is_dir():
        if name is not None:
            raise InputError(f"{source} is a file.", "--file can only be used with a folder.")
        return source
    with contextlib.suppress(OSError):  # raised for a name that is too long
        if name is not None and (source / name).is_file():
            return source / name
    found = sorted(_descriptions_in(source))
    if name is not None:
        found = [path for path in found if path.as_posix().endswith(f"/{name}")]
    if len(found) == 1:
        return found[0]
    if not found:
        what = f"no file {name}" if name else "no URDF, xacro or MJCF file"
        raise InputError(f"{source} has {what}.", "Give the file itself: --from FILE.")
    shown = ", ".join(str(path.relative_to(source)) for path in found[:_MAX_SHOWN])
    more = f" and {len(found) - _MAX_SHOWN} more" if len(found) > _MAX_SHOWN else ""
    raise InputError(
        f"{source} has {len(found)} descriptions: {shown}{more}.", "Choose one: --file NAME."
    )


def _descriptions_in(folder: Path) -> Iterator[Path]:
    count = 0
    for place, folders, files in os.walk(folder):
        folders[:] = [each for each in folders if not each.startswith(".")]
        for file in files:
            count += 1
            if count > _MAX_FILES:
                raise InputError(f"{folder} has too many files.", "Give the file: --from FILE.")
            path = Path(place) / file
            if path.suffix == ".urdf" or (
                path.suffix in (".xacro", ".xml") and path.is_file() and _has_robot(path)
            ):
                yield path


def _has_robot(path: Path) -> bool:
    """Check whether a file describes a robot: an MJCF, or a xacro with more than macros."""
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    except OSError:
        return False
    if path.suffix == ".xml":
        return b"<mujoco" in head and b"<body" in head
    return b"<robot" in head and b" name=" in head.partition(b"<robot")[2].partition(b">")[0]


def _is_mjcf(path: Path) -> bool:
    return path.suffix == ".xml" and is_mjcf(path)


def runs_code(path: Path) -> bool:
    """Check whether reading a description runs the expressions in it.

    Raises:
        FileFormatError: The file cannot be read.
    """
    if _is_mjcf(path):
        return False
    root = parse_xml(path, read_text(path, MAX_URDF_BYTES))
    return path.suffix == ".xacro" or needs_xacro(root)


def read_foreign(
    path: Path,
    packages: Mapping[str, Path],
    arguments: Mapping[str, str],
    *,
    allow_xacro: bool,
    folder: Path | None = None,
) -> Description:
    """Read a foreign description, but not the meshes that it names.

    Only files in ``folder`` are read. Without it, only files in the folder of the description's
    package are read, or, without a package, files in the description's own folder.

    Raises:
        FileFormatError: The description cannot be used; the message names the place and the cause.
        InputError: Reading it would run code, or the reader of its format is not installed.
    """
    found = PackageFolders(path, packages, folder)
    if _is_mjcf(path):
        homes = [found.own_folder(), *([folder.absolute()] if folder else [])]
        urdf = read_mjcf(path, min(homes, key=lambda each: len(each.parts)))
        description = Description(path, urdf, found, list(urdf.warnings))
    else:
        notes: list[str] = []
        if runs_code(path):
            if not allow_xacro:
                raise InputError(
                    f"{path} is a xacro file. Expanding it runs the Python expressions in it.",
                    "If you trust the file and the files that it includes, add --allow-xacro.",
                )
            text = expand_xacro(path, found, arguments)
            notes.append("The macros in the description were expanded with xacro.")
        else:
            text = read_text(path, MAX_URDF_BYTES)
        root = parse_xml(path, text)
        if path.suffix == ".xacro" and not root.child_elements("link"):
            raise FileFormatError(path, "", "it contains only macros", "a file that calls them")
        notes += _make_readable(root)
        urdf = urdf_from_xml(root, found.find_mesh)
        description = Description(path, urdf, found, [*notes, *urdf.warnings])
    check_size(path, urdf)
    return description


_MOVABLE = ("revolute", "continuous", "prismatic")
_SHAPES = ("box", "cylinder", "sphere", "mesh")


def _make_readable(root: XmlElement) -> list[str]:
    """Repair common faults of published files that an arm file does not allow; return notes."""
    joints = [each for each in root.child_elements("joint") if "name" in each.attributes]
    notes: list[str] = []
    for joint in joints:
        kind, name = joint.attributes.get("type", ""), quote(joint.attributes["name"])
        limit = next(iter(joint.child_elements("limit")), None)
        if kind in ("floating", "planar"):
            joint.attributes = {**joint.attributes, "type": "fixed"}
            notes.append(f"joint {name} is {kind}, so it is fixed in place.")
        elif kind == "revolute" and limit is None:
            joint.attributes = {**joint.attributes, "type": "continuous"}
            notes.append(f"joint {name} is revolute without <limit>, so it becomes continuous.")
        elif kind in ("revolute", "prismatic") and limit is not None:
            lower, upper = limit.number("lower", 0.0), limit.number("upper", 0.0)
            if lower == upper:
                joint.attributes = {**joint.attributes, "type": "fixed"}
                notes.append(f"joint {name} has lower = upper = {lower:g}, so it is fixed at zero.")
    notes += _repair_mimics(joints)
    for link in root.child_elements("link"):
        for kind in ("collision", "visual"):
            for each in link.child_elements(kind):
                geometry = each.child_elements("geometry")
                shapes = geometry[0].children if geometry else []
                notes += _repair_shape(link, each, shapes)
    return notes


def _repair_mimics(joints: Sequence[XmlElement]) -> Iterator[str]:
    """Redirect each mimic of a mimic to the joint that leads both; drop mimics without a leader."""
    by_name = {joint.attributes["name"]: joint for joint in joints}
    for name, joint in by_name.items():
        mimic = next(iter(joint.child_elements("mimic")), None)
        if mimic is None:
            continue
        leader = by_name.get(mimic.attributes.get("joint", ""))
        seen = {name}
        multiplier, offset = mimic.number("multiplier", 1.0), mimic.number("offset", 0.0)
        while leader is not None and leader.child_elements("mimic"):
            if leader.attributes["name"] in seen:
                leader = None
                break
            seen.add(leader.attributes["name"])
            next_mimic = leader.child_elements("mimic")[0]
            offset += multiplier * next_mimic.number("offset", 0.0)
            multiplier *= next_mimic.number("multiplier", 1.0)
            leader = by_name.get(next_mimic.attributes.get("joint", ""))
        if leader is None or leader.attributes.get("type") not in _MOVABLE:
            joint.children.remove(mimic)
            yield f"joint {quote(name)} follows no moving joint, so it moves independently."
        elif len(seen) > 1:
            mimic.attributes = {
                "joint": leader.attributes["name"],
                "multiplier": repr(multiplier),
                "offset": repr(offset),
            }
            yield f"joint {quote(name)} follows {quote(leader.attributes['name'])} directly."


def _repair_shape(
    link: XmlElement, each: XmlElement, shapes: Sequence[XmlElement]
) -> Iterator[str]:
    """Replace a capsule by a cylinder and balls, and drop unknown kinds of shapes."""
    kind = shapes[0].tag if len(shapes) == 1 else "nothing"
    if kind in _SHAPES:
        return
    link.children.remove(each)
    if kind != "capsule":
        yield (
            f"link {quote(link.attributes.get('name', ''))} has a shape of type {kind}, which is "
            f"left out."
        )
        return
    capsule = shapes[0]
    radius, length = capsule.attributes.get("radius", ""), capsule.number("length")
    origin = [child for child in each.children if child.tag == "origin"]
    geometry = replace(
        capsule, tag="geometry", attributes={},
        children=[replace(capsule, tag="cylinder", attributes={
            "radius": radius, "length": repr(length)})],
    )  # fmt: skip
    link.children.append(replace(each, children=[*origin, geometry]))
