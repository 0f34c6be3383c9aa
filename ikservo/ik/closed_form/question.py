"""A target as circles: where yaw takes the wanted point, and where roll takes the tool.

Undoing the yaw φ brings the wanted point M and the wanted directions d to the arm's plane; the
roll ψ moves the tool point w and the tool axes a. Planar joints turn what is along the plane by
α and leave what is across. So a solution is ``M(φ) = w(ψ)`` and ``d(φ) = a(ψ)`` across, and a
planar problem along (lecture L4, lifted).
"""

from __future__ import annotations

import cmath
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ikservo.ik.closed_form.aims import Aim, aims_of, tool_at_zero
from ikservo.ik.closed_form.anatomy import Structure, Turn
from ikservo.ik.closed_form.angles import turn_inside
from ikservo.ik.closed_form.choice import nearest_angles_on_arcs
from ikservo.ik.closed_form.directions import nearest_direction
from ikservo.ik.closed_form.links import Angles, inside, three_links, two_links
from ikservo.ik.closed_form.orbits import Orbit
from ikservo.ik.target import Target
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Vector

__all__ = ["Candidate", "Question", "question"]

# What is left of a direction across this little of the plane has no angle in it.
_NO_ANGLE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """Joints (dof,) that meet the wanted point, and how far their tool is from the wanted one."""

    q: Vector
    miss: float


@dataclass(frozen=True, slots=True, eq=False)
class Question:
    """What is asked of an arm, in the arm's own circles.

    Attributes:
        arm: What kind of arm it is.
        start: Where it comes from (dof,), anywhere.
        held: The start inside the limits: joints that do not matter stay there.
        point: Where yaw takes the wanted point.
        tip: Where roll takes the tool point.
        aims: The tool axes that matter: none, one for a direction, three for an orientation.
    """

    arm: Structure
    start: Vector
    held: Vector
    point: Orbit
    tip: Orbit
    aims: tuple[Aim, ...]

    @property
    def yaw_held(self) -> float:
        """Return the yaw of the start inside the limits, 0 for arms without."""
        return float(self.held[self.arm.yaw.column]) if self.arm.yaw else 0.0

    @property
    def roll_held(self) -> float:
        """Return the roll of the start inside the limits, 0 for arms without."""
        return float(self.held[self.arm.wrist[0].column]) if self.arm.wrist else 0.0

    def yaws(self, across: float) -> Iterator[float]:
        """Yield the yaws inside the limits that put the wanted point that far across the plane."""
        angles = self.point.where_across(across)
        for angle in (self.yaw_held,) if angles is None else angles:
            if (yaw := self.yaw_inside(angle)) is not None:
                yield yaw

    def yaw_inside(self, angle_rad: float) -> float | None:
        """Return the turn of a yaw inside the limits, or None."""
        return self.turn_inside(self.arm.yaw, angle_rad)

    def roll_inside(self, angle_rad: float) -> float | None:
        """Return the turn of a roll inside the limits, or None."""
        return self.turn_inside(self.arm.wrist[0] if self.arm.wrist else None, angle_rad)

    def turn_inside(self, turn: Turn | None, angle_rad: float) -> float | None:
        """Return the turn of a joint's angle inside its limits; without the joint, no angle."""
        if turn is None:
            return 0.0
        return turn_inside(angle_rad, turn.lower, turn.upper, float(self.start[turn.column]))

    def from_first_joint(self, yaw_rad: float) -> complex:
        """Return the wanted point in the plane, seen from the plane's first joint."""
        return self.point.along(yaw_rad) - self.arm.plane.pivots[0]

    def heading(self, yaw_rad: float, roll_rad: float) -> float | None:
        """Return α, by how much to turn the last link for the aims; None where any will do."""
        products = [aim.product(yaw_rad, roll_rad) for aim in self.aims]
        if all(abs(product) < _NO_ANGLE for product in products):
            return None
        return cmath.phase(sum(products))

    def placed(self, yaw_rad: float, roll_rad: float, *, bend: bool) -> Iterator[Candidate]:
        """Yield the planar solutions with the tool turned as wanted.

        Where the limits forbid that, the aims bend to the nearest direction allowed if they may.
        """
        plane = self.arm.plane
        links = plane.links(self.tip.along(roll_rad))
        m, near = self.from_first_joint(yaw_rad), plane.angles(self.start)
        alpha = self.heading(yaw_rad, roll_rad)
        if len(links) == 2:
            found = two_links(links[0], links[1], m)
        elif alpha is None:
            found = nearest_angles_on_arcs(links, plane.limits, m, near)
        elif bend:
            found = nearest_direction(links, plane.limits, m, alpha, near)
        else:
            found = three_links(links[0], links[1], links[2], m, alpha)
        for angles in found:
            if (turns := inside(angles, plane.limits, near)) is not None:
                yield self.candidate(yaw_rad, turns, roll_rad)

    def candidate(self, yaw_rad: float, angles: Angles, roll_rad: float) -> Candidate:
        """Return the joints of yaw, planar angles and roll, and what they miss."""
        alpha = sum(angles)
        misses = (aim.miss(yaw_rad, roll_rad, alpha) for aim in self.aims)
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


def question(
    chain: Chain, arm: Structure, target: Target, q0: Vector, wrist_rad: Sequence[float] = ()
) -> Question:
    """Return the target in the circles of the arm; wrist joints behind the roll are held.

    They are held as at the start, or the first ones at ``wrist_rad``.
    """
    held = chain.clip(q0)
    for turn, angle in zip(arm.wrist, wrist_rad, strict=False):
        held[turn.column] = angle
    if arm.zeroed is not None:
        held[arm.zeroed] = 0.0
    tool = tool_at_zero(arm, target)
    for turn in reversed(arm.wrist[1:]):
        tool = turn.applied(float(held[turn.column]), tool)
    return Question(
        arm=arm,
        start=q0,
        held=held,
        point=arm.yaw_back.of_point(target.position),
        tip=arm.roll.of_point(tool[:3, 3]),
        aims=aims_of(target, arm, tool),
    )
