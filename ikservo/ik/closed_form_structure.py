"""Recognise an arm's kinematic structure: parallel and intersecting axes.

With all joints at zero, every joint axis is a line in space. Parallel lines define the plane of the
arm; a line at a right angle before them is the base yaw, and the lines after them are the wrist.
Offsets of any kind are allowed, because rotations of parallel joints never change the component
across the plane.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import numpy as np

from ikservo.ik.subproblems import AxisRotation, EulerAngles, plane_frame
from ikservo.kinematics import Chain, JointType
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.se3 import exp_so3, make_pose

# Deviations [rad or m] this small are rounding.
_EXACT = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class RevoluteAxis:
    """The axis of a revolute joint when all joints are at zero.

    Attributes:
        column: The joint index in q.
        axis: Unit vector (3,), base frame.
        point: A point (3,) on the axis, m, base frame.
        lower: Lower limit, rad.
        upper: Upper limit, rad.
    """

    column: int
    axis: Vector
    point: Vector
    lower: float
    upper: float

    def sample_range(self, parts: Sequence[float]) -> tuple[float, ...]:
        """Return angles at the given fractions of the range, or of a revolution if unlimited."""
        lower = self.lower if math.isfinite(self.lower) else min(-math.pi, self.upper)
        upper = self.upper if math.isfinite(self.upper) else max(math.pi, lower)
        return tuple(min(lower + part * (upper - lower), upper) for part in parts)

    def rotate_pose(self, angle_rad: float, T: Matrix) -> Matrix:
        """Compute the pose (4, 4) rotated by this joint."""
        R = exp_so3(angle_rad * self.axis)
        return make_pose(R @ (T[:3, 3] - self.point) + self.point, R @ T[:3, :3])


@dataclass(frozen=True, slots=True, eq=False)
class PlanarSubchain:
    """The parallel joints, as links in a plane.

    Attributes:
        frame: Rows e1, e2, n (3, 3), base frame; n is the common axis.
        pivots: The joint positions in the plane, e1 + i e2, m.
        columns: The joint indices in q.
        signs: +1 if the joint rotates about n, -1 if it rotates about -n.
        limits: Lower and upper limit of each angle about n, rad.
    """

    frame: Matrix
    pivots: tuple[complex, ...]
    columns: tuple[int, ...]
    signs: tuple[int, ...]
    limits: tuple[tuple[float, float], ...]

    def links(self, tip: complex) -> tuple[complex, ...]:
        """Return the links from joint to joint, the last one to the tip."""
        ends = (*self.pivots[1:], tip)
        return tuple(end - start for start, end in zip(self.pivots, ends, strict=True))

    def angles(self, q: Vector) -> tuple[float, ...]:
        """Compute the angles of the planar joints about n at joints (dof,)."""
        return tuple(s * float(q[c]) for s, c in zip(self.signs, self.columns, strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class ArmStructure:
    """Structure of a chain: base yaw, planar links and wrist, as far as the arm has them.

    Attributes:
        yaw: The first joint, if it is not in the plane.
        plane: Two or three parallel joints.
        wrist: The joints between the plane and the tip.
        centre: The point (3,) where the axes of a wrist of two or three joints meet; None if they
            do not meet.
        tool: Pose (4, 4) of the frame while all joints are zero.
        deviation: The deviation of axes from being parallel [rad] or from meeting [m].
        yaw_back: Rotates points in the base frame back by the yaw.
        roll: Rotates points by the wrist's first joint.
        orient: The last three rotations, if their axes meet in the centre.
        locked_joint: The column of a joint that must be zero for this structure, or None.
        with_wrist_locked: The same arm with the wrist's first joint at zero, if that makes a third
            parallel link; otherwise None.
    """

    yaw: RevoluteAxis | None
    plane: PlanarSubchain
    wrist: tuple[RevoluteAxis, ...]
    centre: Vector | None
    tool: Matrix
    deviation: float
    yaw_back: AxisRotation
    roll: AxisRotation
    orient: EulerAngles | None
    locked_joint: int | None = None
    with_wrist_locked: ArmStructure | None = None

    @property
    def is_exact(self) -> bool:
        """Whether the closed form is exact for the arm; otherwise it is a good seed."""
        return self.deviation < _EXACT

    def __str__(self) -> str:
        parts = ["yaw"] if self.yaw else []
        parts.append(f"planar {len(self.plane.pivots)}R")
        if self.wrist:
            meeting = " with axes that meet at a point" if self.centre is not None else ""
            parts.append("roll" if len(self.wrist) == 1 else f"{len(self.wrist)}R wrist{meeting}")
        return " + ".join(parts)


# Axes that are parallel within this angle count as parallel, and lines that pass this close count
# as meeting. Both are wide enough for rounded angles of published URDFs and for calibrated arms.
_NEARLY_PARALLEL_RAD = 1e-3
_NEARLY_MEETING_M = 1e-4
_SAME_POSE = 1e-9


def recognise_structure(chain: Chain, frame: str | None = None) -> ArmStructure | None:
    """Return the structure of the arm up to a frame, by default the tip; None if it is unknown."""
    chain = chain.rigid
    cached = _structure_cache.setdefault(chain, {})
    if frame in cached:
        return cached[frame]
    joints = _revolute_axes(chain, frame)
    tool = chain.forward(np.zeros(chain.dof), frame)
    found: ArmStructure | None = None
    if joints is not None and _matches_chain(joints, tool, chain, frame):
        found = _assemble_structure(joints, tool)
        if found is not None:
            found = replace(found, with_wrist_locked=_with_locked_wrist_joint(found, joints))
    cached[frame] = found
    return found


_structure_cache: WeakKeyDictionary[Chain, dict[str | None, ArmStructure | None]] = (
    WeakKeyDictionary()
)


def _assemble_structure(joints: tuple[RevoluteAxis, ...], tool: Matrix) -> ArmStructure | None:
    """Return yaw, parallel links and wrist of the joints; None if they are in a different order."""
    if len(joints) < 2:
        return None
    first = 0 if _are_parallel(joints[0], joints[1]) else 1
    others = (i for i in range(first, len(joints)) if not _are_parallel(joints[first], joints[i]))
    count = next(others, len(joints)) - first
    yaw, parallel, wrist = joints[:first], joints[first : first + count], joints[first + count :]
    if count not in (2, 3) or (wrist and not yaw):
        return None
    plane, tilt = _fit_plane(parallel)
    centre, gap_m = _meeting_point(wrist)
    orient: EulerAngles | None = None
    if centre is not None:  # the last rotations: plane and two wrist joints, or three wrist joints
        axes = [plane.frame[2]] if count == 3 else []
        axes += [joint.axis for joint in wrist]
        orient = EulerAngles(*axes) if len(axes) == 3 else None
    return ArmStructure(
        yaw=yaw[0] if yaw else None,
        plane=plane,
        wrist=wrist,
        centre=centre,
        tool=tool,
        deviation=max(tilt, gap_m),
        yaw_back=AxisRotation(plane.frame, -yaw[0].axis, yaw[0].point)
        if yaw
        else AxisRotation(plane.frame),
        roll=AxisRotation(plane.frame, wrist[0].axis, wrist[0].point)
        if wrist
        else AxisRotation(plane.frame),
        orient=orient,
    )


def _with_locked_wrist_joint(
    arm: ArmStructure, joints: tuple[RevoluteAxis, ...]
) -> ArmStructure | None:
    """Convert two links and a wrist to three links, if the wrist's first joint can be zero."""
    if len(arm.plane.pivots) != 2 or len(arm.wrist) < 2:
        return None
    roll = arm.wrist[0]
    straight = _assemble_structure(tuple(joint for joint in joints if joint is not roll), arm.tool)
    if straight is None or not straight.is_exact or len(straight.plane.pivots) != 3:
        return None
    return replace(straight, locked_joint=roll.column) if roll.lower <= 0.0 <= roll.upper else None


def _revolute_axes(chain: Chain, frame: str | None) -> tuple[RevoluteAxis, ...] | None:
    """Compute the axes of all joints that move the frame; None if a joint is not revolute.

    A column of the Jacobian is (axis × r, axis) with r from the axis to the frame, hence r = (axis
    × r) × axis.
    """
    T, J = chain.forward_and_jacobian(np.zeros(chain.dof), frame)
    joints: list[RevoluteAxis] = []
    for i in np.flatnonzero(np.abs(J).sum(axis=0)):
        if chain.kinds[i] is not JointType.REVOLUTE:
            return None
        lower, upper = float(chain.lower_rad[i]), float(chain.upper_rad[i])
        axis, r = J[3:, i], np.cross(J[:3, i], J[3:, i])
        joints.append(RevoluteAxis(int(i), axis, T[:3, 3] - r, lower, upper))
    return tuple(joints)


def _matches_chain(
    joints: tuple[RevoluteAxis, ...], tool: Matrix, chain: Chain, frame: str | None
) -> bool:
    """Check whether the axes move the frame as the chain does; with a mimic joint they do not."""
    for seed in (0.3, -1.1):
        q = seed + 0.7 * np.arange(chain.dof)
        T = tool
        for joint in reversed(joints):
            T = joint.rotate_pose(float(q[joint.column]), T)
        if float(np.abs(T - chain.forward(q, frame)).max()) > _SAME_POSE:
            return False
    return True


def _are_parallel(a: RevoluteAxis, b: RevoluteAxis) -> bool:
    sine = np.cross(a.axis, b.axis)
    return float(np.sqrt(sine @ sine)) < _NEARLY_PARALLEL_RAD


def _fit_plane(joints: tuple[RevoluteAxis, ...]) -> tuple[PlanarSubchain, float]:
    """Return the plane perpendicular to parallel joints, and their largest misalignment [rad]."""
    n = joints[0].axis
    frame = plane_frame(n)
    signs = tuple(1 if float(joint.axis @ n) > 0 else -1 for joint in joints)
    return PlanarSubchain(
        frame=frame,
        pivots=tuple(complex(*(frame[:2] @ joint.point)) for joint in joints),
        columns=tuple(joint.column for joint in joints),
        signs=signs,
        limits=tuple(
            (t.lower, t.upper) if sign > 0 else (-t.upper, -t.lower)
            for sign, t in zip(signs, joints, strict=True)
        ),
    ), max(float(np.abs(s * t.axis - n).max()) for s, t in zip(signs, joints, strict=True))


def _meeting_point(joints: tuple[RevoluteAxis, ...]) -> tuple[Vector | None, float]:
    """Compute the meeting point (3,) of the axes of two or three joints, and its error [m]."""
    if len(joints) not in (2, 3) or _are_parallel(joints[0], joints[1]):
        return None, 0.0
    beside = [np.eye(3) - np.outer(joint.axis, joint.axis) for joint in joints]
    offsets = [B @ joint.point for B, joint in zip(beside, joints, strict=True)]
    centre = np.asarray(np.linalg.solve(sum(beside), sum(offsets)), dtype=np.float64)
    distances = [np.linalg.norm(B @ centre - o) for B, o in zip(beside, offsets, strict=True)]
    gap_m = float(max(distances))
    return (centre, gap_m) if gap_m < _NEARLY_MEETING_M else (None, 0.0)
