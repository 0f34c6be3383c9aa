"""Read the links, joints and shapes of MJCF descriptions, which MuJoCo compiles."""

from __future__ import annotations

import importlib
import math
import posixpath
import re
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from ikservo.errors import FileFormatError, InputError
from ikservo.files.reading import path_inside, quote, read_text, require_file
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.se3 import exp_so3, make_pose, quaternion_to_matrix
from ikservo.model.base_placement import pose_origin, pose_rpy
from ikservo.model.urdf_types import (
    Box,
    Cylinder,
    Shape,
    Sphere,
    Surface,
    Urdf,
    UrdfJoint,
    UrdfJointType,
    UrdfLink,
    UrdfMimic,
)
from ikservo.model.urdf_xml import XmlElement, parse_xml
from ikservo.remedies import install_command

_MAX_BYTES = 4 * 1024 * 1024
_MAX_INCLUDES = 32
_MAX_MESH_BYTES = 32 * 1024 * 1024
_MAX_MESHES_BYTES = 256 * 1024 * 1024  # of all meshes; a mesh counts each time it is named
_BROKEN_NAME = re.compile(r"""\b(file\w*|\w+dir)\s*=\s*("[^"]*[\t\r\n]|'[^']*[\t\r\n])""")
_DROPPED_SECTIONS = (
    "size", "option", "statistic", "visual", "custom", "extension", "contact", "sensor", "actuator",
    "tendon", "deformable", "keyframe",
)  # fmt: skip
_DROPPED_ELEMENTS = {
    "mujoco": _DROPPED_SECTIONS,
    "asset": ("texture", "hfield"),
    "material": ("layer",),
    "equality": ("connect", "weld", "tendon", "flex", "distance"),
    **dict.fromkeys(("worldbody", "body", "frame"), ("camera", "light")),
}
_DROPPED_ATTRIBUTES = {"material": ("texture",), "compiler": ("texturedir",)}
"""Elements and attributes that an arm does not need, removed before MuJoCo compiles the model."""


def arm_xml(path: Path, folder: Path) -> str:
    """Return an MJCF with its included files, reduced to the structure of the arm.

    Textures, height fields, key frames, cameras, sensors and actuators are left out before
    anything is compiled. Meshes are referred to by their absolute paths.

    Raises:
        FileFormatError: A file is outside the folder, too large or not a regular file, or the XML
            cannot be used; the message names the place.
    """
    root, files = _read_whole(path, path.parent, folder, set())
    elements = _all_elements(root)
    settings: dict[str, str] = {}
    for element in elements:
        _check_element(element)
        if element.tag == "compiler":
            own = element.attributes
            both = {"meshdir": own["assetdir"]} if "assetdir" in own else {}
            settings |= both | dict(own)
    mesh_bytes = 0
    for element in elements:
        if element.tag == "mesh" and "file" in element.attributes:
            name = element.attributes["file"]
            if settings.get("strippath") == "true":
                name = posixpath.basename(name)
            name = posixpath.join(settings.get("meshdir", ""), name)
            mesh = _resolve_inside(element, path.parent, folder, name)
            require_file(mesh)
            size = mesh.stat().st_size
            mesh_bytes += size
            if size > _MAX_MESH_BYTES or mesh_bytes > _MAX_MESHES_BYTES:
                most = f"at most {_MAX_MESH_BYTES >> 20} MiB, {_MAX_MESHES_BYTES >> 20} MiB in all"
                raise element.error(f"mesh {quote(name)} is too large", most)
            element.attributes = {**element.attributes, "file": mesh.as_posix()}
    for element in elements:
        dropped = _DROPPED_ELEMENTS.get(element.tag, ())
        element.children = [
            each
            for each in element.children
            if each.tag not in dropped and each.attributes.get("type") != "hfield"
        ]
        dropped = ("user", *_DROPPED_ATTRIBUTES.get(element.tag, ()))
        element.attributes = {k: v for k, v in element.attributes.items() if k not in dropped}
    return "".join(_written(root, _LineCount(show_lines=files == 1)))


def _read_whole(path: Path, place: Path, folder: Path, seen: set[Path]) -> tuple[XmlElement, int]:
    """Read an MJCF with its included files inserted; return it and the number of files read."""
    seen.add(path.resolve())
    text = read_text(path, _MAX_BYTES)
    if _BROKEN_NAME.search(text):  # MuJoCo keeps these characters; XML readers make them blanks
        found = "has a tab or a line break in a file's name"
        raise FileFormatError(path, "", found, "names without tabs and line breaks")
    root = parse_xml(path, text)
    for element in _all_elements(root):
        children: list[XmlElement] = []
        for child in element.children:
            if child.tag != "include" or "file" not in child.attributes:
                children.append(child)
                continue
            # The folder settings of the compiler must not change the name.
            inner = _resolve_inside(child, place, folder, child.attributes["file"])
            if inner.resolve() in seen:
                raise child.error(
                    f"includes {quote(inner.name)} again", "a file that includes each file once"
                )
            if len(seen) == _MAX_INCLUDES:
                raise FileFormatError(
                    path, "", "it includes too many files", f"at most {_MAX_INCLUDES}"
                )
            children += _read_whole(inner, place, folder, seen)[0].children
        element.children = children
    return root, len(seen)


_MULTIPLIES = ("replicate", "composite", "flexcomp", "attach", "model", "plugin", "skin")


def _check_element(element: XmlElement) -> None:
    """Refuse elements that multiply bodies or load other models, and ranges that are reversed."""
    attributes = element.attributes
    if element.tag in _MULTIPLIES or (element.tag == "mesh" and "builtin" in attributes):
        raise element.error(
            f"<{element.tag}> cannot be used", "a file in which each body is written out"
        )
    for key in ("range", "actuatorfrcrange") if element.tag == "joint" else ():
        if key in attributes and attributes.get(_SWITCHES[key]) != "false":
            lower, upper = element.pair(key, most=math.inf)
            if lower > upper or lower == upper != 0.0:  # MuJoCo would ignore the limit
                found = f"joint {quote(attributes.get('name', ''))} has {key} {lower:g} {upper:g}"
                raise element.error(found, "the lower number first")


_SWITCHES = {"range": "limited", "actuatorfrcrange": "actuatorfrclimited"}


@dataclass(slots=True)
class _LineCount:
    """Counter of the written lines of XML, so that MuJoCo reports an element's original line."""

    show_lines: bool
    line: int = 1


def _written(element: XmlElement, at: _LineCount) -> Iterator[str]:
    if at.show_lines and element.line > at.line:
        yield "\n" * (element.line - at.line)
        at.line = element.line
    attributes = "".join(f" {key}={quoteattr(text)}" for key, text in element.attributes.items())
    yield f"<{element.tag}{attributes}>"
    for child in element.children:
        yield from _written(child, at)
    yield f"</{element.tag}>"


def _resolve_inside(element: XmlElement, place: Path, folder: Path, name: str) -> Path:
    home = folder.resolve()
    if place.resolve().is_relative_to(home) and not posixpath.isabs(name):
        relative = posixpath.join(place.resolve().relative_to(home).as_posix(), name)
        found = path_inside(home, posixpath.normpath(relative))
        if found is not None:
            return found
    found = f"<{element.tag}> names {quote(name)}, outside the model's folder"
    inside = "a file inside it; or give a folder that contains all files: --from FOLDER --file NAME"
    raise element.error(found, inside)


def _all_elements(root: XmlElement) -> list[XmlElement]:
    found = [root]
    for element in found:
        found.extend(element.children)
    return found


def body_shapes(mujoco: Any, model: Any, body: int, shift_m: Vector) -> tuple[list[Shape], ...]:  # noqa: ANN401  # no types
    """Return the collision shapes and the visual shapes of a body.

    Planes and height fields are left out, because they belong to the surroundings. The origin of
    the link's frame is at ``shift_m`` (3,) in the body's frame.
    """
    collide, drawn = list[Shape](), list[Shape]()
    first = int(model.body_geomadr[body])
    for geom in range(first, first + int(model.body_geomnum[body])):
        T = make_pose(model.geom_pos[geom] - shift_m, quaternion_to_matrix(model.geom_quat[geom]))
        collides = bool(model.geom_contype[geom] or model.geom_conaffinity[geom])
        (collide if collides else drawn).extend(_geom_shapes(mujoco, model, geom, T))
    return collide, drawn


def _geom_shapes(mujoco: Any, model: Any, geom: int, T: Matrix) -> list[Shape]:  # noqa: ANN401
    kinds, size = mujoco.mjtGeom, [float(x) for x in model.geom_size[geom]]
    at, rpy = pose_origin(T), pose_rpy(T)
    match kinds(int(model.geom_type[geom])):
        case kinds.mjGEOM_SPHERE:
            return [Sphere(size[0], at, rpy)]
        case kinds.mjGEOM_CAPSULE:
            ends = (T @ make_pose((0.0, 0.0, side * size[1])) for side in (-1, 1))
            caps = [Sphere(size[0], pose_origin(end), rpy) for end in ends]
            return [Cylinder(size[0], 2 * size[1], at, rpy), *caps]
        case kinds.mjGEOM_CYLINDER:
            return [Cylinder(size[0], 2 * size[1], at, rpy)]
        case kinds.mjGEOM_BOX | kinds.mjGEOM_ELLIPSOID:
            return [Box((2 * size[0], 2 * size[1], 2 * size[2]), at, rpy)]
        case kinds.mjGEOM_MESH:
            mesh = int(model.geom_dataid[geom])
            first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
            corners = np.array(model.mesh_vert[first : first + count], dtype=np.float64)
            first, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
            faces = np.array(model.mesh_face[first : first + count])
            return [Surface(corners[faces], at, rpy)]
        case _:
            return []


def read_mjcf(path: Path, folder: Path | None = None) -> Urdf:
    """Read bodies, hinges, slides, geoms and sites of an MJCF.

    Bodies and sites become links; each further joint of a body gets a separate link. A robot with a
    free base is fixed at its initial pose; loose objects are left out. The names of all files are
    checked first, so that no file outside ``folder``, by default the folder of the MJCF, is opened.

    Raises:
        FileFormatError: A file is outside the folder, MuJoCo refuses the model, or the model has a
            joint that no servo can drive.
        InputError: The extra ``physics`` is not installed.
    """
    text = arm_xml(path, path.parent if folder is None else folder)
    try:
        mujoco: Any = importlib.import_module("mujoco")  # it has no types
    except ImportError:
        raise InputError(
            f"{path} is an MJCF file; reading it needs mujoco, which is not installed.",
            f"Install it: {install_command('physics')}",
        ) from None
    try:
        with _warnings_withheld(mujoco):
            model = mujoco.MjModel.from_xml_string(text)
    except (ValueError, OSError) as error:
        why = " ".join(str(error).split())[:200]
        if len(text.split("\n")) == 1:  # with several files, line numbers mislead
            why = re.sub(r",? line -?\d+", "", why)
        raise FileFormatError(path, "", f"MuJoCo refuses it: {why}", "a valid MJCF") from error
    return _BodyTreeReader(path, mujoco, model).build_urdf()


@contextmanager
def _warnings_withheld(mujoco: Any) -> Generator[None]:  # noqa: ANN401  # no types
    """Keep MuJoCo from printing warnings and writing MUJOCO_LOG.TXT to the current folder."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(_ignore)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def _ignore(_: str) -> None:
    pass


class _BodyTreeReader:
    """Reader of links and joints from the bodies of a compiled model, parents first."""

    def __init__(self, path: Path, mujoco: Any, model: Any) -> None:  # noqa: ANN401
        self._path, self._mujoco, self._model = path, mujoco, model
        self._links: list[UrdfLink] = []
        self._joints: list[UrdfJoint] = []
        # Origin of each body's link frame in the body's own frame: at its last joint.
        self._shift_m: list[Vector] = []
        self._names: list[str] = []

    def build_urdf(self) -> Urdf:
        model, root_of = self._model, self._model.body_rootid
        # Loose objects move freely or by mocap, and carry no other joints.
        moves_freely = np.equal(model.jnt_type, self._mujoco.mjtJoint.mjJNT_FREE)
        roots = {*model.jnt_bodyid[moves_freely], *np.flatnonzero(model.body_mocapid >= 0)}
        roots.difference_update(root_of[model.jnt_bodyid[~moves_freely]])
        loose = {body for body in range(model.nbody) if root_of[body] in roots}
        for body in range(model.nbody):
            self._names.append(model.body(body).name or f"body_{body}")
            held = body and body not in loose
            self._shift_m.append(self._add_joints(body) if held else np.zeros(3))
            if body not in loose:
                self._add_link(body)
        for site in range(model.nsite):
            body = int(model.site_bodyid[site])
            if body in loose:
                continue
            name = model.site(site).name or f"site_{site}"
            if name in {link.name for link in self._links}:
                name = f"{name}_site"
            T = make_pose(
                model.site_pos[site] - self._shift_m[body],
                quaternion_to_matrix(model.site_quat[site]),
            )
            self._links.append(UrdfLink(name))
            self._joints.append(_fixed_joint(f"{name}_mount", self._names[body], name, T))
        things = [body for body in sorted(loose) if model.body_rootid[body] == body]
        notes = tuple(f"{self._names[each]} is a loose object and is left out." for each in things)
        return Urdf("", tuple(self._links), tuple(self._joints), self._names[0], notes)

    def _add_joints(self, body: int) -> Vector:
        """Add the joints of a body; return the origin of its link's frame in the body's frame."""
        model, parent = self._model, int(self._model.body_parentid[body])
        at = make_pose(-self._shift_m[parent]) @ make_pose(
            model.body_pos[body], quaternion_to_matrix(model.body_quat[body])
        )
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        if count and int(model.jnt_type[first]) == self._mujoco.mjtJoint.mjJNT_FREE:
            count = 0  # the base of a free robot is fixed where it stands
        above, shift_m = self._names[parent], np.zeros(3)
        for joint in range(first, first + count):
            anchor_m = np.array(model.jnt_pos[joint])
            last = joint == first + count - 1
            child = self._names[body] if last else f"{self._names[body]}_{joint - first + 1}"
            self._joints.append(
                self._make_moving_joint(joint, above, child, at @ make_pose(anchor_m - shift_m))
            )
            if not last:
                self._links.append(UrdfLink(child))
            above, at, shift_m = child, np.eye(4), anchor_m
        if not count:
            name = f"{self._names[body]}_mount"
            self._joints.append(_fixed_joint(name, above, self._names[body], at))
        return shift_m

    def _make_moving_joint(self, joint: int, parent: str, child: str, T: Matrix) -> UrdfJoint:
        model, kinds = self._model, self._mujoco.mjtJoint
        name = model.joint(joint).name or f"joint_{joint}"
        kind, axis = kinds(int(model.jnt_type[joint])), np.array(model.jnt_axis[joint])
        if kind not in (kinds.mjJNT_HINGE, kinds.mjJNT_SLIDE):
            raise FileFormatError(
                self._path, f"joint {name}", "is a ball joint", "a hinge or slide"
            )
        slides, limited = kind == kinds.mjJNT_SLIDE, bool(model.jnt_limited[joint])
        zero = float(model.qpos0[model.jnt_qposadr[joint]])
        T = T @ (
            make_pose(-zero * axis) if slides else make_pose(np.zeros(3), exp_so3(-zero * axis))
        )
        low, high = (float(x) for x in model.jnt_range[joint]) if limited else (-math.inf, math.inf)
        revolute = UrdfJointType.REVOLUTE if limited else UrdfJointType.CONTINUOUS
        return UrdfJoint(
            name=name,
            kind=UrdfJointType.PRISMATIC if slides else revolute,
            parent=parent,
            child=child,
            xyz_m=pose_origin(T),
            rpy_rad=pose_rpy(T),
            axis=(float(axis[0]), float(axis[1]), float(axis[2])),
            lower=low,
            upper=high,
            mimic=self._find_mimic(joint),
        )

    def _find_mimic(self, joint: int) -> UrdfMimic | None:
        """Find the joint that ``joint`` follows through an equality constraint, or None."""
        model, kinds = self._model, self._mujoco.mjtEq
        for i in range(model.neq):
            ties_joints = kinds(int(model.eq_type[i])) == kinds.mjEQ_JOINT
            led = ties_joints and model.eq_active0[i] and model.eq_obj1id[i] == joint
            if led and int(model.eq_obj2id[i]) >= 0:
                leader = int(model.eq_obj2id[i])
                zero, zero_leader = (
                    float(model.qpos0[model.jnt_qposadr[j]]) for j in (joint, leader)
                )
                offset, slope = (float(x) for x in model.eq_data[i][:2])
                name = model.joint(leader).name or f"joint_{leader}"
                return UrdfMimic(name, slope, zero + offset - slope * zero_leader)
        return None

    def _add_link(self, body: int) -> None:
        model, shift_m = self._model, self._shift_m[body]
        collide, drawn = body_shapes(self._mujoco, model, body, shift_m)
        com = make_pose(
            model.body_ipos[body] - shift_m, quaternion_to_matrix(model.body_iquat[body])
        )
        ixx, iyy, izz = (float(x) for x in model.body_inertia[body])
        self._links.append(
            UrdfLink(
                name=self._names[body],
                mass_kg=float(model.body_mass[body]) if body else 0.0,
                com_m=pose_origin(com),
                inertia_rpy_rad=pose_rpy(com),
                inertia_kg_m2=(ixx, 0.0, 0.0, iyy, 0.0, izz),
                collisions=tuple(collide),
                visuals=tuple(drawn),
            )
        )


def _fixed_joint(name: str, parent: str, child: str, T: Matrix) -> UrdfJoint:
    return UrdfJoint(name, UrdfJointType.FIXED, parent, child, pose_origin(T), pose_rpy(T))
