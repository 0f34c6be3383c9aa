"""Problem that a closed form solves: target, axis constraints, remaining freedom.

Undoing the yaw φ brings the target point M and the target directions d to the arm's plane; the roll
ψ moves the tool point w and the tool axes a. Planar joints rotate the component along the plane by
α and keep the component across it. A solution therefore satisfies ``M(φ) = w(ψ)`` and ``d(φ) =
a(ψ)`` across the plane, and solves a planar problem along the plane.
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


@dataclass(frozen=True, slots=True)
class AxisConstraint:
    """A tool axis a and its target direction d."""

    target: CircleTrace
    tool: CircleTrace

    def angle_error(self, yaw_rad: float, roll_rad: float, alpha_rad: float) -> float:
        """Compute the distance of d from a rotated by α: about the angle between the two [rad]."""
        along = self.target.in_plane_part(yaw_rad)
        along -= cmath.rect(1.0, alpha_rad) * self.tool.in_plane_part(roll_rad)
        across = self.target.normal_part(yaw_rad) - self.tool.normal_part(roll_rad)
        return abs(complex(abs(along), across))


def axis_constraints(target: Target, arm: ArmStructure, tool: Matrix) -> tuple[AxisConstraint, ...]:
    """Return the axis constraints of a target; ``tool`` is the pose (4, 4) at yaw and roll zero."""
    pairs: list[tuple[Vector, Vector]] = []
    if target.rotation is not None:
        pairs += zip(tool[:3, :3].T, target.rotation.T, strict=True)
    if target.target_axis is not None:
        pairs.append((tool[:3, :3] @ target.axis, target.target_axis))
    return tuple(
        AxisConstraint(arm.yaw_back.trace_vector(d), arm.roll.trace_vector(a)) for a, d in pairs
    )


def tool_at_zero(arm: ArmStructure, target: Target) -> Matrix:
    """Compute the pose (4, 4) of the target's point while all joints are zero."""
    if target.offset_m is None:
        return arm.tool
    return arm.tool @ make_pose(target.offset_m)


# A direction whose part along the plane is this small has no usable angle in the plane.
_NO_ANGLE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """Joints (dof,) that reach the target point, and the orientation error of their tool."""

    q: Vector
    miss: float


@dataclass(frozen=True, slots=True, eq=False)
class AnalyticProblem:
    """A target for an arm, expressed by the circles on which its joints move points.

    Attributes:
        arm: The structure of the arm.
        start: The start (dof,), which may be outside the limits.
        held: The start, clamped to the limits; joints without influence on the target stay there.
        point: The circle of the target point about the yaw axis.
        tip: The circle of the tool point about the roll axis.
        aims: The axis constraints: none, one for a direction, three for an orientation.
    """

    arm: ArmStructure
    start: Vector
    held: Vector
    point: CircleTrace
    tip: CircleTrace
    aims: tuple[AxisConstraint, ...]

    @property
    def start_yaw(self) -> float:
        """The yaw of the start, clamped to the limits; 0 for arms without yaw."""
        return float(self.held[self.arm.yaw.column]) if self.arm.yaw else 0.0

    @property
    def start_roll(self) -> float:
        """The roll of the start, clamped to the limits; 0 for arms without roll."""
        return float(self.held[self.arm.wrist[0].column]) if self.arm.wrist else 0.0

    def yaws(self, across: float) -> Iterator[float]:
        """Yield the yaws within the limits that put the target point at a distance from the plane.

        ``across`` is this distance from the plane of the arm, metres.
        """
        angles = self.point.angles_at_normal(across)
        for angle in (self.start_yaw,) if angles is None else angles:
            if (yaw := self.yaw_within_limits(angle)) is not None:
                yield yaw

    def yaw_within_limits(self, angle_rad: float) -> float | None:
        """Return the equivalent yaw inside the limits, or None."""
        return self.angle_within_limits(self.arm.yaw, angle_rad)

    def roll_within_limits(self, angle_rad: float) -> float | None:
        """Return the equivalent roll inside the limits, or None."""
        return self.angle_within_limits(self.arm.wrist[0] if self.arm.wrist else None, angle_rad)

    def angle_within_limits(self, joint: RevoluteAxis | None, angle_rad: float) -> float | None:
        """Return a joint's equivalent angle inside its limits; 0 if the arm lacks the joint."""
        if joint is None:
            return 0.0
        return nearest_equivalent_angle(
            angle_rad, joint.lower, joint.upper, float(self.start[joint.column])
        )

    def target_in_plane(self, yaw_rad: float) -> complex:
        """Return the target point in the plane, relative to the plane's first joint."""
        return self.point.in_plane_part(yaw_rad) - self.arm.plane.pivots[0]

    def tool_direction(self, yaw_rad: float, roll_rad: float) -> float | None:
        """Return α, the rotation of the last link that the aims require; None if it is free."""
        # The phase of each product d ā along the plane is the angle from a to d.
        products = [
            aim.target.in_plane_part(yaw_rad) * aim.tool.in_plane_part(roll_rad).conjugate()
            for aim in self.aims
        ]
        if all(abs(product) < _NO_ANGLE for product in products):
            return None
        return cmath.phase(sum(products))

    def planar_candidates(
        self, yaw_rad: float, roll_rad: float, *, bend: bool
    ) -> Iterator[Candidate]:
        """Yield the planar solutions with the tool in the required direction.

        If the limits forbid this direction and ``bend`` is set, the nearest allowed angle is used.
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
            if (inside := within_limits(angles, plane.limits, near)) is not None:
                yield self.candidate(yaw_rad, inside, roll_rad)

    def candidate(self, yaw_rad: float, angles: Angles, roll_rad: float) -> Candidate:
        """Return the joint positions for yaw, planar angles and roll, with orientation error."""
        alpha = sum(angles)
        misses = (aim.angle_error(yaw_rad, roll_rad, alpha) for aim in self.aims)
        return Candidate(self.joints(yaw_rad, angles, (roll_rad,)), max(misses, default=0.0))

    def joints(self, yaw_rad: float, angles: Angles, wrist_rad: Sequence[float]) -> Vector:
        """Return q (dof,): the start with other yaw, planar angles and first wrist joints."""
        arm, q = self.arm, self.held.copy()
        if arm.yaw:
            q[arm.yaw.column] = yaw_rad
        for column, sign, angle in zip(arm.plane.columns, arm.plane.signs, angles, strict=True):
            q[column] = sign * angle
        for joint, angle in zip(arm.wrist, wrist_rad, strict=False):
            q[joint.column] = angle
        return q


def make_problem(
    chain: Chain, arm: ArmStructure, target: Target, q0: Vector, wrist_rad: Sequence[float] = ()
) -> AnalyticProblem:
    """Express a target by the circles of the arm; wrist joints after the roll are held.

    The held joints keep the start's angles; ``wrist_rad`` replaces those of the first wrist joints.
    """
    held = chain.clip(q0)
    for joint, angle in zip(arm.wrist, wrist_rad, strict=False):
        held[joint.column] = angle
    if arm.locked_joint is not None:
        held[arm.locked_joint] = 0.0
    tool = tool_at_zero(arm, target)
    for joint in reversed(arm.wrist[1:]):
        tool = joint.rotate_pose(float(held[joint.column]), tool)
    return AnalyticProblem(
        arm=arm,
        start=q0,
        held=held,
        point=arm.yaw_back.trace_point(target.position),
        tip=arm.roll.trace_point(tool[:3, 3]),
        aims=axis_constraints(target, arm, tool),
    )
