"""Where no solution exists: the best that is known in closed form, and seeds for the rest."""

from __future__ import annotations

from dataclasses import dataclass

from numpy.typing import ArrayLike

from ikservo.ik.closed_form.directions import allowed_arcs
from ikservo.ik.closed_form.nearest import nearest_angles
from ikservo.ik.closed_form.question import Question, question
from ikservo.ik.closed_form.reach import by_position
from ikservo.ik.closed_form.solutions import ranked, rough_solutions, start_of
from ikservo.ik.closed_form.structure import structure
from ikservo.ik.closed_form.yaw_and_roll import NO_FREEDOM
from ikservo.ik.target import Target
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Vector

__all__ = ["Directions", "closed_form_seeds", "closest", "intervals"]


@dataclass(frozen=True, slots=True)
class Directions:
    """Directions of the last planar link with which a point can be reached (lecture L4).

    Attributes:
        yaw_rad: The base yaw that goes with them; 0 for arms without.
        elbow: 0 or 1.
        lower_rad: First direction, counted from the link's direction while all joints are zero.
        upper_rad: Last direction, at most a full turn further.
    """

    yaw_rad: float
    elbow: int
    lower_rad: float
    upper_rad: float


def intervals(chain: Chain, target: Target, q0: ArrayLike | None = None) -> tuple[Directions, ...]:
    """Return every interval of directions with which three links reach the target's point.

    Args:
        chain: The arm.
        target: Its point is used; what it wants of the tool is not.
        q0: Where the wrist stays (dof,), rad; the middle of the limits if None.

    Returns:
        The intervals of each yaw and elbow inside the limits; none where the point is out of
        reach or the arm has no three parallel joints. Arms that have them only while the forearm
        does not roll have it at zero.
    """
    arm = structure(chain, target.frame)
    arm = arm.straight or arm if arm else None
    if arm is None or len(arm.plane.pivots) != 3:
        return ()
    asked = question(chain, arm, target, start_of(chain, q0))
    links = arm.plane.links(asked.tip.along(asked.roll_held))
    return tuple(
        Directions(yaw, elbow, arc.lower_rad, arc.upper_rad)
        for yaw in asked.yaws(asked.tip.across(asked.roll_held))
        for elbow, arcs in enumerate(
            allowed_arcs(links, arm.plane.limits, asked.from_first_joint(yaw))
        )
        for arc in arcs
    )


def closest(chain: Chain, target: Target, q0: ArrayLike | None = None) -> tuple[Vector, ...]:
    """Return joints (dof,) that come as close to an unreachable target as any, if that is known.

    Known in closed form are the nearest point of a planar arm, and the nearest direction of an
    arm whose wrist cannot help: it meets the point, and turns the tool as far as the limits go.
    The best is among what is returned; all of it is inside the limits.
    """
    arm, start = structure(chain, target.frame), start_of(chain, q0)
    if arm is None or not arm.exact:
        return ()
    asked = question(chain, arm, target, start)
    if arm.yaw is None:
        in_plane = [candidate.q for candidate in asked.placed(0.0, 0.0, bend=True)]
        return ranked(in_plane, start) or _stretched(asked, 0.0)
    if target.only_position or len(arm.wrist) > 1 or _has_freedom(asked):
        return ()
    return ranked((candidate.q for candidate in by_position(asked)), start)


def _has_freedom(asked: Question) -> bool:
    """Return whether roll or yaw can trade the point against the direction."""
    sways = [aim.tool.sway for aim in asked.aims]
    on_yaw_axis = asked.point.where_across(asked.tip.across(asked.roll_held)) is None
    return on_yaw_axis or max(sways, default=0.0) > NO_FREEDOM or asked.tip.sway > NO_FREEDOM


def closed_form_seeds(
    chain: Chain, target: Target, q0: ArrayLike | None = None
) -> tuple[Vector, ...]:
    """Return joints (dof,) inside the limits that are good starts for a search.

    They are the solutions of the recognised structure, where there are none the joints that meet
    the point alone, and where the point is out of reach the links stretched towards it.
    """
    arm, start = structure(chain, target.frame), start_of(chain, q0)
    if arm is None:
        return ()
    asked = question(chain, arm, target, start)
    found = rough_solutions(chain, target, asked) or [c.q for c in by_position(asked)]
    if found:
        return ranked(found, start)
    yaws = tuple(asked.yaws(asked.tip.across(asked.roll_held))) or (asked.yaw_held,)
    return tuple(q for yaw in yaws for q in _stretched(asked, yaw)[:1])


def _stretched(asked: Question, yaw: float) -> tuple[Vector, ...]:
    """Return the joints whose planar links come nearest, best first."""
    plane = asked.arm.plane
    found = nearest_angles(
        plane.links(asked.tip.along(asked.roll_held)),
        plane.limits,
        asked.from_first_joint(yaw),
        plane.angles(asked.start),
    )
    return tuple(asked.joints(yaw, angles, (asked.roll_held,)) for angles in found)
