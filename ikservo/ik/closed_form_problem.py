"""The problem a closed form solves: target, axis constraints, remaining freedom.

Undoing the yaw φ brings the wanted point M and the wanted directions d to the arm's plane; the
roll ψ moves the tool point w and the tool axes a. Planar joints turn what is along the plane by
α and leave what is across. So a solution is ``M(φ) = w(ψ)`` and ``d(φ) = a(ψ)`` across, and a
planar problem along (lecture L4, lifted).
"""

from __future__ import annotations

import cmath
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ikservo.ik.closed_form_structure import ArmStructure, RevoluteAxis
from ikservo.ik.planar import (
    Angles,
    nearest_direction,
    nearest_on_direction_arcs,
    solve_planar_2r,
    solve_planar_3r,
    within_limits,
)
from ikservo.ik.problem import Target
from ikservo.ik.subproblems import CircleTrace, nearest_equivalent_angle
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.se3 import make_pose

__all__ = [
    "AnalyticProblem",
    "AxisConstraint",
    "Candidate",
    "axis_constraints",
    "make_problem",
    "tool_at_zero",
]


@dataclass(frozen=True, slots=True)
class AxisConstraint:
    """A tool axis a and where it shall point, d."""

    wanted: CircleTrace
    tool: CircleTrace

    def phase_product(self, yaw_rad: float, roll_rad: float) -> complex:
        """Return d ā along the plane: its phase is the turn α that takes a to d."""
        return self.wanted.in_plane_part(yaw_rad) * self.tool.in_plane_part(roll_rad).conjugate()

    def angle_error(self, yaw_rad: float, roll_rad: float, alpha_rad: float) -> float:
        """Return how far a, turned by α, ends from d (about the angle in rad)."""
        along = self.wanted.in_plane_part(yaw_rad)
        along -= cmath.rect(1.0, alpha_rad) * self.tool.in_plane_part(roll_rad)
        across = self.wanted.normal_part(yaw_rad) - self.tool.normal_part(roll_rad)
        return abs(complex(abs(along), across))


def axis_constraints(target: Target, arm: ArmStructure, tool: Matrix) -> tuple[AxisConstraint, ...]:
    """Return what a target wants of the tool, whose pose (4, 4) is given with yaw and roll zero."""
    return tuple(
        AxisConstraint(arm.yaw_back.trace_vector(d), arm.roll.trace_vector(a))
        for a, d in _axis_pairs(target, tool)
    )


def tool_at_zero(arm: ArmStructure, target: Target) -> Matrix:
    """Return the pose (4, 4) of the target's point while all joints are zero."""
    if target.offset_m is None:
        return arm.tool
    return arm.tool @ make_pose(target.offset_m)


def _axis_pairs(target: Target, tool: Matrix) -> Iterator[tuple[Vector, Vector]]:
    """Yield each tool axis that matters, base frame at zero, and where it shall point."""
    if target.rotation is not None:
        yield from zip(tool[:3, :3].T, target.rotation.T, strict=True)
    if target.wanted_axis is not None:
        yield tool[:3, :3] @ target.axis, target.wanted_axis


# What is left of a direction across this little of the plane has no angle in it.
_NO_ANGLE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """Joints (dof,) that meet the wanted point, and how far their tool is from the wanted one."""

    q: Vector
    miss: float


@dataclass(frozen=True, slots=True, eq=False)
class AnalyticProblem:
    """What is asked of an arm, in the arm's own circles.

    Attributes:
        arm: What kind of arm it is.
        start: Where it comes from (dof,), anywhere.
        held: The start inside the limits: joints that do not matter stay there.
        point: Where yaw takes the wanted point.
        tip: Where roll takes the tool point.
        aims: The tool axes that matter: none, one for a direction, three for an orientation.
    """

    arm: ArmStructure
    start: Vector
    held: Vector
    point: CircleTrace
    tip: CircleTrace
    aims: tuple[AxisConstraint, ...]

    @property
    def start_yaw(self) -> float:
        """Return the yaw of the start inside the limits, 0 for arms without."""
        return float(self.held[self.arm.yaw.column]) if self.arm.yaw else 0.0

    @property
    def start_roll(self) -> float:
        """Return the roll of the start inside the limits, 0 for arms without."""
        return float(self.held[self.arm.wrist[0].column]) if self.arm.wrist else 0.0

    def yaws(self, across: float) -> Iterator[float]:
        """Yield the yaws inside the limits that put the wanted point that far across the plane."""
        angles = self.point.angles_at_normal(across)
        for angle in (self.start_yaw,) if angles is None else angles:
            if (yaw := self.yaw_within_limits(angle)) is not None:
                yield yaw

    def yaw_within_limits(self, angle_rad: float) -> float | None:
        """Return the turn of a yaw inside the limits, or None."""
        return self.angle_within_limits(self.arm.yaw, angle_rad)

    def roll_within_limits(self, angle_rad: float) -> float | None:
        """Return the turn of a roll inside the limits, or None."""
        return self.angle_within_limits(self.arm.wrist[0] if self.arm.wrist else None, angle_rad)

    def angle_within_limits(self, turn: RevoluteAxis | None, angle_rad: float) -> float | None:
        """Return the turn of a joint's angle inside its limits; without the joint, no angle."""
        if turn is None:
            return 0.0
        return nearest_equivalent_angle(
            angle_rad, turn.lower, turn.upper, float(self.start[turn.column])
        )

    def target_in_plane(self, yaw_rad: float) -> complex:
        """Return the wanted point in the plane, seen from the plane's first joint."""
        return self.point.in_plane_part(yaw_rad) - self.arm.plane.pivots[0]

    def tool_direction(self, yaw_rad: float, roll_rad: float) -> float | None:
        """Return α, by how much to turn the last link for the aims; None where any will do."""
        products = [aim.phase_product(yaw_rad, roll_rad) for aim in self.aims]
        if all(abs(product) < _NO_ANGLE for product in products):
            return None
        return cmath.phase(sum(products))

    def planar_candidates(
        self, yaw_rad: float, roll_rad: float, *, bend: bool
    ) -> Iterator[Candidate]:
        """Yield the planar solutions with the tool turned as wanted.

        Where the limits forbid that, the aims bend to the nearest direction allowed if they may.
        """
        plane = self.arm.plane
        links = plane.links(self.tip.in_plane_part(roll_rad))
        m, near = self.target_in_plane(yaw_rad), plane.angles(self.start)
        alpha = self.tool_direction(yaw_rad, roll_rad)
        if len(links) == 2:
            found = solve_planar_2r(links[0], links[1], m)
        elif alpha is None:
            found = nearest_on_direction_arcs(links, plane.limits, m, near)
        elif bend:
            found = nearest_direction(links, plane.limits, m, alpha, near)
        else:
            found = solve_planar_3r(links[0], links[1], links[2], m, alpha)
        for angles in found:
            if (turns := within_limits(angles, plane.limits, near)) is not None:
                yield self.candidate(yaw_rad, turns, roll_rad)

    def candidate(self, yaw_rad: float, angles: Angles, roll_rad: float) -> Candidate:
        """Return the joints of yaw, planar angles and roll, and what they miss."""
        alpha = sum(angles)
        misses = (aim.angle_error(yaw_rad, roll_rad, alpha) for aim in self.aims)
        return Candidate(self.joints(yaw_rad, angles, (roll_rad,)), max(misses, default=0.0))

    def joints(self, yaw_rad: float, angles: Angles, wrist_rad: Sequence[float]) -> Vector:
        """Return q (dof,): the start, with yaw, planar angles and the first wrist joints set."""
        arm, q = self.arm, self.held.copy()
        if arm.yaw:
            q[arm.yaw.column] = yaw_rad
        for column, sign, angle in zip(arm.plane.columns, arm.plane.signs, angles, strict=True):
            q[column] = sign * angle
        for turn, angle in zip(arm.wrist, wrist_rad, strict=False):
            q[turn.column] = angle
        return q


def make_problem(
    chain: Chain, arm: ArmStructure, target: Target, q0: Vector, wrist_rad: Sequence[float] = ()
) -> AnalyticProblem:
    """Return the target in the circles of the arm; wrist joints behind the roll are held.

    They are held as at the start, or the first ones at ``wrist_rad``.
    """
    held = chain.clip(q0)
    for turn, angle in zip(arm.wrist, wrist_rad, strict=False):
        held[turn.column] = angle
    if arm.locked_joint is not None:
        held[arm.locked_joint] = 0.0
    tool = tool_at_zero(arm, target)
    for turn in reversed(arm.wrist[1:]):
        tool = turn.rotate_pose(float(held[turn.column]), tool)
    return AnalyticProblem(
        arm=arm,
        start=q0,
        held=held,
        point=arm.yaw_back.trace_point(target.position),
        tip=arm.roll.trace_point(tool[:3, 3]),
        aims=axis_constraints(target, arm, tool),
    )
