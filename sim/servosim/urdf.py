"""A small URDF reader: joints, masses, collision shapes."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from functools import lru_cache
from math import copysign, cos, inf, sin
from pathlib import Path
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml import ElementTree
from defusedxml.common import DefusedXmlException
from numpy.typing import NDArray

from servosim.errors import ArmFileError

Matrix = NDArray[np.float64]


def read_origin(element: Element) -> Matrix:
    """Return the homogeneous transform of an `<origin>`: fixed-axis roll, pitch, yaw."""
    origin = element.find("origin")
    roll, pitch, yaw = read_numbers(origin, "rpy", (0.0, 0.0, 0.0))
    cr, sr, cp, sp, cy, sy = cos(roll), sin(roll), cos(pitch), sin(pitch), cos(yaw), sin(yaw)
    T = np.eye(4)
    T[:3, :3] = (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )
    T[:3, 3] = read_numbers(origin, "xyz", (0.0, 0.0, 0.0))
    return T


def read_numbers(
    element: Element | None, key: str, default: tuple[float, ...]
) -> tuple[float, ...]:
    """Read the numbers of an attribute."""
    text = None if element is None else element.get(key)
    return default if text is None else tuple(float(word) for word in text.split())


SPACING_M, MOST_STEPS = 0.02, 50  # spacing of points on a surface, most of them along an edge
# A cylinder counts as the box whose square section has the same area; a sphere as the inner cube.
SQUARE, CUBE = math.sqrt(math.pi) / 2.0, 1.0 / math.sqrt(3.0)


@dataclass(frozen=True, slots=True)
class BoxShape:
    """A box.

    Attributes:
        body: Index of the moving joint that carries it, -1 at the base.
        T: The box's frame in that joint's frame; the origin is the centre of the box.
        half_m: Half the lengths of its edges (3,).
        points_m: Points on its surface (k, 3), in its own frame.
    """

    body: int
    T: Matrix
    half_m: Matrix
    points_m: Matrix


def link_shapes(link: Element, body: int, T: Matrix) -> list[BoxShape]:
    """Return the boxes, cylinders and spheres of a link; visual ones if it has no others.

    Args:
        link: The element.
        body: Index of the moving joint that carries it.
        T: The link's frame in that joint's frame.
    """
    found: list[BoxShape] = []
    for collision in link.findall("collision") or link.findall("visual"):
        half_m = _half_extents_m(collision)
        if half_m is not None:
            found.append(
                BoxShape(body, T @ read_origin(collision), half_m, _surface_points(half_m))
            )
    return found


def _half_extents_m(collision: Element) -> Matrix | None:
    box, cylinder, sphere = (
        collision.find(f"geometry/{kind}") for kind in ("box", "cylinder", "sphere")
    )
    if box is not None:
        return np.array(read_numbers(box, "size", (0.0, 0.0, 0.0))) / 2.0
    if cylinder is not None:
        radius_m = SQUARE * float(cylinder.attrib["radius"])
        return np.array([radius_m, radius_m, float(cylinder.attrib["length"]) / 2.0])
    if sphere is not None:
        return np.full(3, CUBE * float(sphere.attrib["radius"]))
    return None


def _surface_points(half_m: Matrix) -> Matrix:
    """Return points of a grid on the surface (k, 3), corners included."""
    halves: list[float] = half_m.tolist()
    edges: list[list[float]] = [
        np.linspace(-h, h, 2 + min(int(2.0 * h / SPACING_M), MOST_STEPS)).tolist() for h in halves
    ]
    grid = np.array(list(itertools.product(*edges)))
    return grid[(np.abs(np.abs(grid) - half_m) < 1e-9).any(axis=1)]


MOVING = frozenset({"revolute", "continuous", "prismatic"})


@dataclass(slots=True)
class Mass:
    """A rigid body: mass, centre [m], rotational inertia about the centre [kg m²], in one frame."""

    mass_kg: float = 0.0
    com_m: Matrix = field(default_factory=lambda: np.zeros(3))
    inertia_kg_m2: Matrix = field(default_factory=lambda: np.zeros((3, 3)))

    def add_body(self, other: Mass, T: Matrix) -> None:
        """Add a body whose frame is `T` in this body's frame (parallel axis theorem)."""
        mass_kg = self.mass_kg + other.mass_kg
        if mass_kg <= 0.0:
            return
        R, other_com_m = T[:3, :3], T[:3, :3] @ other.com_m + T[:3, 3]
        com_m = (self.mass_kg * self.com_m + other.mass_kg * other_com_m) / mass_kg
        self.inertia_kg_m2 = (
            self.inertia_kg_m2
            + R @ other.inertia_kg_m2 @ R.T
            + _parallel_axis_term(self.mass_kg, self.com_m - com_m)
            + _parallel_axis_term(other.mass_kg, other_com_m - com_m)
        )
        self.mass_kg, self.com_m = mass_kg, com_m


@dataclass(slots=True)
class MovingJoint:
    """A joint with everything rigidly fixed behind it; its frame's z axis is the joint's axis.

    Attributes:
        name: The name in the file.
        parent: Index of the moving joint before it, -1 at the base.
        sliding: Whether it is prismatic instead of revolute.
        T_parent_joint: The frame at zero, in the parent's frame.
        lower: Limit [rad or m]; -inf when continuous.
        upper: Limit [rad or m]; inf when continuous.
        mimic: Joint that it follows; its own name if it follows none.
        multiplier: `q = multiplier * q_mimic + offset`.
        offset: See multiplier.
        body: The body that it carries, up to the next moving joints.
    """

    name: str
    parent: int
    sliding: bool
    T_parent_joint: Matrix
    lower: float
    upper: float
    mimic: str
    multiplier: float
    offset: float
    body: Mass = field(default_factory=Mass)


BASE_AXES = {"forward": 0, "left": 1, "raise": 2}


def base_pose(words: str) -> Matrix:
    """Return the pose of a URDF's base from the words of its arm file: ``rotate 90, raise 0.05``.

    Raises:
        ValueError: The text does not have this form.
    """
    T = np.eye(4)
    for part in filter(None, words.split(",")):
        word, amount = part.split()
        step = np.eye(4)
        if (word, amount) == ("upside", "down"):
            step[1, 1] = step[2, 2] = -1.0
        elif word == "rotate":
            turn = math.radians(float(amount))
            step[:2, :2] = ((cos(turn), -sin(turn)), (sin(turn), cos(turn)))
        elif word in BASE_AXES:
            step[BASE_AXES[word], 3] = float(amount)
        else:
            raise ValueError(f"{word!r} does not place a base; try rotate 90 or raise 0.05")
        T = step @ T
    return T


def read_joints(path: Path, base: str = "") -> list[MovingJoint]:
    """Read the tree of moving joints, parents before children.

    Raises:
        ArmFileError: The file is not a usable URDF.
    """
    return list(_walk_tree(path, base).joints)


def read_shapes(path: Path, base: str = "") -> list[BoxShape]:
    """Read the collision shapes; their joints are indices into the list of `read_joints`.

    Raises:
        ArmFileError: The file is not a usable URDF, or one of its links has a collision mesh.
    """
    walk = _walk_tree(path, base)
    if walk.meshes:
        why = "has a collision mesh; use boxes, cylinders or spheres"
        raise ArmFileError(path, f"link {walk.meshes[0]!r}", why)
    return list(walk.shapes)


def read_link_frame(path: Path, link: str, base: str = "") -> tuple[int, Matrix]:
    """Read which joint in the list of `read_joints` carries a link, and its frame there.

    Raises:
        ArmFileError: The file is not a usable URDF, or has no such link.
    """
    frames = _walk_tree(path, base).link_frames
    if link not in frames:
        raise ArmFileError(path, "", f"no link {link!r}; has: {', '.join(frames)}")
    return frames[link]


MAX_BYTES = 4 * 1024 * 1024


def _walk_tree(path: Path, base: str) -> _TreeWalk:
    try:
        with path.open("rb") as file:
            text = file.read(MAX_BYTES + 1)
        if len(text) > MAX_BYTES:
            raise ArmFileError(path, "", f"larger than {MAX_BYTES} bytes")
        return _walk_document(text, base)
    except RecursionError as error:
        raise ArmFileError(path, "", "too many links in a row") from error
    except (OSError, ParseError, DefusedXmlException, KeyError, ValueError) as error:
        raise ArmFileError(path, "", f"not a usable URDF ({error})") from error


@lru_cache(maxsize=8)
def _walk_document(text: bytes, base: str) -> _TreeWalk:
    """Walk a document once for its joints, shapes and tip; callers must not change the result."""
    return _TreeWalk(ElementTree.fromstring(text), base_pose(base))


class _TreeWalk:
    """One pass from the root link to the tips."""

    def __init__(self, robot: Element, T_base: Matrix) -> None:
        self.joints: list[MovingJoint] = []
        self.shapes: list[BoxShape] = []
        self.meshes: list[str] = []
        self.link_frames: dict[str, tuple[int, Matrix]] = {}
        self._links = {link.attrib["name"]: link for link in robot.iter("link")}
        self._children: dict[str, list[Element]] = {name: [] for name in self._links}
        for joint in robot.findall("joint"):
            self._children[_require_child(joint, "parent").attrib["link"]].append(joint)
        hung = {_require_child(joint, "child").attrib["link"] for joint in robot.findall("joint")}
        for name in self._links:
            if name not in hung:
                self._visit_link(name, -1, T_base)

    def _visit_link(self, link: str, parent: int, T: Matrix) -> None:
        """Visit a link; `T` is its frame in the frame of the moving joint `parent`."""
        self.shapes += link_shapes(self._links[link], parent, T)
        if self._links[link].find("collision/geometry/mesh") is not None:
            self.meshes.append(link)
        self.link_frames[link] = (parent, T)
        if parent >= 0:
            body, T_link_body = _read_mass(self._links[link])
            self.joints[parent].body.add_body(body, T @ T_link_body)
        for joint in self._children[link]:
            T_joint = T @ read_origin(joint)
            below = _require_child(joint, "child").attrib["link"]
            if joint.attrib["type"] in MOVING:
                A = _rotation_z_to(read_numbers(joint.find("axis"), "xyz", (1.0, 0.0, 0.0)))
                self.joints.append(_make_moving_joint(joint, parent, T_joint @ A))
                self._visit_link(below, len(self.joints) - 1, A.T)
            else:
                self._visit_link(below, parent, T_joint)


def _make_moving_joint(joint: Element, parent: int, T: Matrix) -> MovingJoint:
    name, kind = joint.attrib["name"], joint.attrib["type"]
    limit, mimic = joint.find("limit"), joint.find("mimic")
    bounded = limit is not None and kind != "continuous"
    return MovingJoint(
        name=name,
        parent=parent,
        sliding=kind == "prismatic",
        T_parent_joint=T,
        lower=_read_number(limit, "lower", 0.0) if bounded else -inf,
        upper=_read_number(limit, "upper", 0.0) if bounded else inf,
        mimic=name if mimic is None else mimic.attrib["joint"],
        multiplier=_read_number(mimic, "multiplier", 1.0),
        offset=_read_number(mimic, "offset", 0.0),
    )


def _read_mass(link: Element) -> tuple[Mass, Matrix]:
    """Return a link's body in the frame of its inertial, and that frame in the link's frame."""
    inertial = link.find("inertial")
    if inertial is None:
        return Mass(), np.eye(4)
    tensor = inertial.find("inertia")
    xx, yy, zz, xy, xz, yz = (
        _read_number(tensor, key, 0.0) for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    )
    matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    mass_kg = _read_number(inertial.find("mass"), "value", 0.0)
    return Mass(mass_kg, np.zeros(3), matrix), read_origin(inertial)


def _rotation_z_to(axis: tuple[float, ...]) -> Matrix:
    """Return a rotation of z to the axis (Duff et al. 2017, without a branch at the pole)."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    sign = copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    T = np.eye(4)
    T[:3, 0] = 1.0 + sign * x * x * a, sign * b, -sign * x
    T[:3, 1] = b, sign + y * y * a, -y
    T[:3, 2] = x, y, z
    return T


def _parallel_axis_term(mass_kg: float, r: Matrix) -> Matrix:
    return mass_kg * (float(r @ r) * np.eye(3) - np.outer(r, r))


def _require_child(element: Element, tag: str) -> Element:
    found = element.find(tag)
    if found is None:
        raise KeyError(f"<{element.tag} name={element.get('name')!r}> without <{tag}>")
    return found


def _read_number(element: Element | None, key: str, default: float) -> float:
    return default if element is None else float(element.get(key, default))
