"""The parts of an arm that a closed form needs: base yaw, parallel links, wrist."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ikservo.ik.closed_form.orbits import Spin
from ikservo.ik.closed_form.three_turns import ThreeTurns
from ikservo.kinematics.se3 import Matrix, Vector, exp_so3, pose

__all__ = ["Plane", "Structure", "Turn"]

# Deviations [rad or m] this small are rounding.
_EXACT = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """One turning joint while all joints are zero.

    Attributes:
        column: Its place in q.
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

    def parts(self, parts: Sequence[float]) -> tuple[float, ...]:
        """Return angles inside the limits at the given parts of the range, a turn if unlimited."""
        lower = self.lower if math.isfinite(self.lower) else min(-math.pi, self.upper)
        upper = self.upper if math.isfinite(self.upper) else max(math.pi, lower)
        return tuple(min(lower + part * (upper - lower), upper) for part in parts)

    def applied(self, angle_rad: float, T: Matrix) -> Matrix:
        """Return the pose (4, 4) turned by this joint."""
        R = exp_so3(angle_rad * self.axis)
        return pose(R @ (T[:3, 3] - self.point) + self.point, R @ T[:3, :3])


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """The parallel joints, as links in a plane.

    Attributes:
        frame: Rows e1, e2, n (3, 3), base frame; n is the common axis.
        pivots: The joints' places in the plane, e1 + i e2, m.
        columns: Their places in q.
        signs: +1 where the joint turns about n, -1 where it turns against it.
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
        """Return the angles about n of joints (dof,)."""
        return tuple(s * float(q[c]) for s, c in zip(self.signs, self.columns, strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class Structure:
    """A chain as base yaw, planar links and wrist, each where the arm has it.

    Attributes:
        yaw: The first joint, where it is not one of the plane.
        plane: Two or three parallel joints.
        wrist: The joints behind them.
        centre: The point (3,) where the axes of a wrist of two or three joints meet, or None.
        tool: Pose (4, 4) of the frame while all joints are zero.
        deviation: How far axes are from parallel [rad] or from meeting [m].
        yaw_back: Takes points of the base back by the yaw.
        roll: Turns points by the wrist's first joint.
        orient: The last three turns, where they meet in the centre.
        zeroed: The column of a joint that this structure asks to stand at zero, or None.
        straight: The same arm with the wrist's first joint at zero, where that makes a third
            parallel link; None elsewhere.
    """

    yaw: Turn | None
    plane: Plane
    wrist: tuple[Turn, ...]
    centre: Vector | None
    tool: Matrix
    deviation: float
    yaw_back: Spin
    roll: Spin
    orient: ThreeTurns | None
    zeroed: int | None = None
    straight: Structure | None = None

    @property
    def exact(self) -> bool:
        """Return whether the closed form is the arm's own; else it is a very good seed."""
        return self.deviation < _EXACT

    def __str__(self) -> str:
        parts = ["yaw"] if self.yaw else []
        parts.append(f"planar {len(self.plane.pivots)}R")
        if self.wrist:
            meeting = " that meets in a point" if self.centre is not None else ""
            parts.append("roll" if len(self.wrist) == 1 else f"{len(self.wrist)}R wrist{meeting}")
        return " + ".join(parts)
