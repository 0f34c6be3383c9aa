"""A small reader of URDF: the joints that move and the masses that hang on them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from math import copysign, inf
from pathlib import Path
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml import ElementTree
from defusedxml.common import DefusedXmlException

from servosim.errors import ArmFileError
from servosim.shapes import Shape, shapes_of
from servosim.urdf_numbers import Matrix, numbers, origin

MOVING = frozenset({"revolute", "continuous", "prismatic"})


@dataclass(slots=True)
class Mass:
    """A rigid body: mass, centre [m], rotational inertia about the centre [kg m²], in one frame."""

    mass_kg: float = 0.0
    com_m: Matrix = field(default_factory=lambda: np.zeros(3))
    inertia_kg_m2: Matrix = field(default_factory=lambda: np.zeros((3, 3)))

    def absorb(self, other: Mass, T: Matrix) -> None:
        """Add another body, whose frame is `T` in this one's (parallel axes)."""
        mass_kg = self.mass_kg + other.mass_kg
        if mass_kg <= 0.0:
            return
        R, other_com_m = T[:3, :3], T[:3, :3] @ other.com_m + T[:3, 3]
        com_m = (self.mass_kg * self.com_m + other.mass_kg * other_com_m) / mass_kg
        self.inertia_kg_m2 = (
            self.inertia_kg_m2
            + R @ other.inertia_kg_m2 @ R.T
            + _steiner(self.mass_kg, self.com_m - com_m)
            + _steiner(other.mass_kg, other_com_m - com_m)
        )
        self.mass_kg, self.com_m = mass_kg, com_m


@dataclass(slots=True)
class MovingJoint:
    """A joint with all that is rigidly fixed behind it; its frame's z axis is the joint's axis.

    Attributes:
        name: In the file.
        parent: Index of the moving joint before it, -1 at the base.
        sliding: Prismatic rather than revolute.
        T_parent_joint: Its frame at zero, in the parent's frame.
        lower: Limit [rad or m]; -inf when continuous.
        upper: Limit [rad or m]; inf when continuous.
        mimic: Joint that it copies, its own name when none.
        multiplier: `q = multiplier * q_mimic + offset`.
        offset: See multiplier.
        body: What hangs on it, up to the next moving joints.
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


def read_joints(path: Path) -> list[MovingJoint]:
    """Read the tree of moving joints, parents before children.

    Raises:
        ArmFileError: The file is no URDF that can be used.
    """
    return _walk(path).joints


def read_shapes(path: Path) -> list[Shape]:
    """Read the collision shapes and behind which moving joint each is, as `read_joints` counts.

    Raises:
        ArmFileError: The file is no URDF that can be used.
    """
    return _walk(path).shapes


def read_link_frame(path: Path, link: str) -> tuple[int, Matrix]:
    """Read behind which moving joint a link is, as `read_joints` counts, and its frame there.

    Raises:
        ArmFileError: The file is no URDF that can be used, or has no such link.
    """
    frames = _walk(path).link_frames
    if link not in frames:
        raise ArmFileError(path, "", f"no link {link!r}; has: {', '.join(frames)}")
    return frames[link]


def _walk(path: Path) -> _Walk:
    try:
        return _Walk(ElementTree.fromstring(path.read_bytes()))
    except (OSError, ParseError, DefusedXmlException, KeyError, ValueError) as error:
        raise ArmFileError(path, "", f"not a usable URDF ({error})") from error


class _Walk:
    """One pass from the root link to the tips."""

    def __init__(self, robot: Element) -> None:
        self.joints: list[MovingJoint] = []
        self.shapes: list[Shape] = []
        self.link_frames: dict[str, tuple[int, Matrix]] = {}
        self._links = {link.attrib["name"]: link for link in robot.iter("link")}
        self._children: dict[str, list[Element]] = {name: [] for name in self._links}
        for joint in robot.findall("joint"):
            self._children[_child(joint, "parent").attrib["link"]].append(joint)
        for name in self._roots(robot):
            self._visit(name, -1, np.eye(4))

    def _roots(self, robot: Element) -> Iterator[str]:
        hung = {_child(joint, "child").attrib["link"] for joint in robot.findall("joint")}
        return (name for name in self._links if name not in hung)

    def _visit(self, link: str, parent: int, T: Matrix) -> None:
        """`T` is the link's frame in the frame of the moving joint `parent`."""
        self.shapes += shapes_of(self._links[link], parent, T)
        self.link_frames[link] = (parent, T)
        if parent >= 0:
            body, T_link_body = _mass(self._links[link])
            self.joints[parent].body.absorb(body, T @ T_link_body)
        for joint in self._children[link]:
            T_joint = T @ origin(joint)
            below = _child(joint, "child").attrib["link"]
            if joint.attrib["type"] in MOVING:
                A = _z_to(numbers(joint.find("axis"), "xyz", (1.0, 0.0, 0.0)))
                self.joints.append(_moving(joint, parent, T_joint @ A))
                self._visit(below, len(self.joints) - 1, A.T)
            else:
                self._visit(below, parent, T_joint)


def _moving(joint: Element, parent: int, T: Matrix) -> MovingJoint:
    name, kind = joint.attrib["name"], joint.attrib["type"]
    limit, mimic = joint.find("limit"), joint.find("mimic")
    bounded = limit is not None and kind != "continuous"
    return MovingJoint(
        name=name,
        parent=parent,
        sliding=kind == "prismatic",
        T_parent_joint=T,
        lower=_number(limit, "lower", 0.0) if bounded else -inf,
        upper=_number(limit, "upper", 0.0) if bounded else inf,
        mimic=name if mimic is None else mimic.attrib["joint"],
        multiplier=_number(mimic, "multiplier", 1.0),
        offset=_number(mimic, "offset", 0.0),
    )


def _mass(link: Element) -> tuple[Mass, Matrix]:
    """A link's body in the frame of its own inertial, and that frame in the link's."""
    inertial = link.find("inertial")
    if inertial is None:
        return Mass(), np.eye(4)
    tensor = inertial.find("inertia")
    xx, yy, zz, xy, xz, yz = (
        _number(tensor, key, 0.0) for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    )
    matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    mass_kg = _number(inertial.find("mass"), "value", 0.0)
    return Mass(mass_kg, np.zeros(3), matrix), origin(inertial)


def _z_to(axis: tuple[float, ...]) -> Matrix:
    """A rotation that takes z to the axis (Duff et al. 2017, without a branch at the pole)."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    sign = copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    T = np.eye(4)
    T[:3, 0] = 1.0 + sign * x * x * a, sign * b, -sign * x
    T[:3, 1] = b, sign + y * y * a, -y
    T[:3, 2] = x, y, z
    return T


def _steiner(mass_kg: float, r: Matrix) -> Matrix:
    return mass_kg * (float(r @ r) * np.eye(3) - np.outer(r, r))


def _child(element: Element, tag: str) -> Element:
    found = element.find(tag)
    if found is None:
        raise KeyError(f"<{element.tag} name={element.get('name')!r}> without <{tag}>")
    return found


def _number(element: Element | None, key: str, default: float) -> float:
    return default if element is None else float(element.get(key, default))
