"""The parts of a URDF as values: links, joints, shapes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

from ikservo.errors import UnknownNameError

if TYPE_CHECKING:  # for type checkers only, because reading a URDF needs no numpy
    import numpy as np
    from numpy.typing import NDArray

Triple = tuple[float, float, float]


class UrdfJointType(Enum):
    """Kind of motion of a joint; the reader refuses ``floating`` and ``planar``."""

    FIXED = "fixed"
    REVOLUTE = "revolute"
    CONTINUOUS = "continuous"
    PRISMATIC = "prismatic"

    @property
    def is_movable(self) -> bool:
        """Whether the joint has a coordinate."""
        return self is not UrdfJointType.FIXED


@dataclass(frozen=True, slots=True)
class UrdfMimic:
    """A joint that follows another joint: ``q = multiplier * q_joint + offset``."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True, slots=True)
class UrdfJoint:
    """One ``<joint>``: the pose of the child frame in the parent frame, and its motion there.

    Attributes:
        name: Name, unique in the file.
        kind: The kind of motion.
        parent: Name of its parent link.
        child: Name of its child link.
        xyz_m: Origin of the child frame in the parent frame.
        rpy_rad: Orientation of the child frame, fixed axes: ``Rz(yaw) @ Ry(pitch) @ Rx(roll)``.
        axis: Unit vector in the child frame; (1, 0, 0), without meaning, on a fixed joint.
        lower: Lower limit, rad or m; -inf if continuous, 0 if fixed.
        upper: Upper limit, rad or m; +inf if continuous, 0 if fixed.
        effort: Largest torque or force, N m or N; +inf if the file gives none.
        velocity: Largest speed, rad/s or m/s; +inf if the file gives none.
        mimic: The joint that it follows; None if it follows no joint.
        line: The line at which the element starts in the file, from 1; 0 without a file.
    """

    name: str
    kind: UrdfJointType
    parent: str
    child: str
    xyz_m: Triple
    rpy_rad: Triple
    axis: Triple = (1.0, 0.0, 0.0)
    lower: float = 0.0
    upper: float = 0.0
    effort: float = math.inf
    velocity: float = math.inf
    mimic: UrdfMimic | None = None
    line: int = 0


@dataclass(frozen=True, slots=True)
class Box:
    """A box centred on its origin; ``size_m`` are the full edge lengths."""

    size_m: Triple
    xyz_m: Triple
    rpy_rad: Triple


@dataclass(frozen=True, slots=True)
class Cylinder:
    """A cylinder centred on its origin, along its z axis."""

    radius_m: float
    length_m: float
    xyz_m: Triple
    rpy_rad: Triple


@dataclass(frozen=True, slots=True)
class Sphere:
    """A sphere centred on its origin."""

    radius_m: float
    xyz_m: Triple
    rpy_rad: Triple


@dataclass(frozen=True, slots=True)
class Mesh:
    """A reference to a mesh; the reader never opens it.

    Attributes:
        filename: The name in the file.
        path: The resolved file if it is under the model's own folder, else None.
        scale: Factor along each axis.
        xyz_m: Origin in the link frame.
        rpy_rad: Orientation in the link frame.
    """

    filename: str
    path: Path | None
    scale: Triple
    xyz_m: Triple
    rpy_rad: Triple


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A mesh that is already in memory; ``triangles_m`` are corners (n, 3, 3) in its own frame."""

    triangles_m: NDArray[np.float64]
    xyz_m: Triple
    rpy_rad: Triple


Shape = Box | Cylinder | Sphere | Mesh | Surface


@dataclass(frozen=True, slots=True)
class UrdfLink:
    """One ``<link>``: a rigid body with its mass and shapes, all in the link frame.

    Attributes:
        name: Name, unique in the file.
        mass_kg: Mass; 0 if the file gives no ``<inertial>``.
        com_m: Centre of mass, which is also the origin of the inertia frame.
        inertia_rpy_rad: Orientation of the inertia frame, as in `UrdfJoint.rpy_rad`.
        inertia_kg_m2: ixx, ixy, ixz, iyy, iyz, izz about the centre of mass.
        collisions: Shapes that must not touch anything.
        visuals: Shapes to draw.
        line: The line at which the element starts in the file, from 1; 0 without a file.
        colours: Red, green and blue of each visual shape, 0 to 1, or None if the file gives none;
            empty if it has no colours.
    """

    name: str
    mass_kg: float = 0.0
    com_m: Triple = (0.0, 0.0, 0.0)
    inertia_rpy_rad: Triple = (0.0, 0.0, 0.0)
    inertia_kg_m2: tuple[float, float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    collisions: tuple[Shape, ...] = ()
    visuals: tuple[Shape, ...] = ()
    line: int = 0
    colours: tuple[Triple | None, ...] = ()


@dataclass(frozen=True, slots=True)
class Urdf:
    """A whole robot: one tree of links, connected by joints.

    Attributes:
        name: The robot's name; empty if the file gives none.
        links: The links, in file order.
        joints: The joints, in file order, which need not be the order of the tree.
        root: Name of the only link that is not the child of a joint.
        warnings: Things that are allowed but probably a mistake, one line each.
    """

    name: str
    links: tuple[UrdfLink, ...]
    joints: tuple[UrdfJoint, ...]
    root: str
    warnings: tuple[str, ...] = ()

    def link(self, name: str) -> UrdfLink:
        """Return the link of that name.

        Raises:
            UnknownNameError: There is no such link; the closest name is suggested.
        """
        links = {link.name: link for link in self.links}
        if name not in links:
            raise UnknownNameError("link", name, links)
        return links[name]

    def joints_to(self, link: str) -> tuple[UrdfJoint, ...]:
        """Return the joints between the root and a link, root first, including fixed joints.

        Raises:
            UnknownNameError: There is no such link.
        """
        carrier = {joint.child: joint for joint in self.joints}
        path: list[UrdfJoint] = []
        at = self.link(link).name
        while at != self.root:
            path.append(carrier[at])
            at = carrier[at].parent
        return tuple(reversed(path))
