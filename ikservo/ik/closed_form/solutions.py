"""Every closed-form solution of a target, inside the limits, the nearest to the start first."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain as joined
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from ikservo.ik.closed_form.angles import TURN_RAD
from ikservo.ik.closed_form.pose import by_pose, orientations
from ikservo.ik.closed_form.question import Candidate, Question, question
from ikservo.ik.closed_form.reach import by_aim, by_position
from ikservo.ik.closed_form.sharpen import sharpened
from ikservo.ik.closed_form.structure import structure
from ikservo.ik.closed_form.yaw_and_roll import ROUNDED
from ikservo.ik.target import Target
from ikservo.kinematics import Chain, finite_vector
from ikservo.kinematics.se3 import Vector

__all__ = ["ranked", "rough_solutions", "solutions", "start_of"]

# Two solutions this near [rad] are one, met by rounding from two sides.
_ONE_SOLUTION_RAD = 1e-7
# Wrists to try, as parts of the ranges, where the start's own does not reach.
_WRISTS = (0.5, 0.2, 0.8, 0.02, 0.98)
# Axes that are not quite parallel turn the tool up to this many times as far from the wanted; the
# worst is near the axis of yaw. Sharpening tells who was meant.
_MISSED_PER_DEVIATION = 1e3


def solutions(chain: Chain, target: Target, q0: ArrayLike | None = None) -> tuple[Vector, ...]:
    """Return joints (dof,) that meet the target, one for each branch, nearest to q0 first.

    Where the target leaves freedom, each branch answers with the choice nearest the start: the
    wrist stays, and the last link keeps its direction as well as the limits allow (lecture L4).
    Angles that differ by full turns are one solution; the turn nearest q0 stands for it.

    Args:
        chain: The arm.
        target: What is wanted.
        q0: Where the arm comes from (dof,), rad; the middle of the limits if None.

    Returns:
        Joints inside the limits; none where the target is out of reach, or where the arm has no
        closed form for it (``structure`` tells).

    Raises:
        BadValueError: q0 has a wrong shape or is not finite.
        UnknownNameError: The target's frame is no link of the arm.
    """
    arm, start = structure(chain, target.frame), start_of(chain, q0)
    if arm is None:
        return ()
    found = rough_solutions(chain, target, question(chain, arm, target, start))
    if not arm.exact:
        found = [s for q in found if (s := sharpened(chain, target, q)) is not None]
    return ranked(found, start)


def rough_solutions(chain: Chain, target: Target, asked: Question) -> list[Vector]:
    """Return the solutions of the recognised structure, in no order.

    They are the arm's own where the structure is exact.
    """
    if target.only_position:
        attempts = joined((by_position(asked),), _with_another_wrist(chain, target, asked))
        return [c.q for c in next((found for found in attempts if found), ())]
    if len(asked.arm.wrist) < 2:
        met = 2.0 * ROUNDED + _MISSED_PER_DEVIATION * asked.arm.deviation
        return [candidate.q for candidate in by_aim(asked) if candidate.miss < met]
    if asked.arm.orient is None:
        return []
    R_start = chain.forward(asked.start, target.frame)[:3, :3]
    for R in orientations(target, R_start):
        if found := list(by_pose(asked, target, R)):
            return found
    return []


def _with_another_wrist(
    chain: Chain, target: Target, asked: Question
) -> Iterator[tuple[Candidate, ...]]:
    """Yield what six joints reach when the wrist does not stay as at the start.

    First the forearm's roll at zero makes three parallel links, then a few wrists are tried.
    """
    arm, start = asked.arm, asked.start
    if arm.straight:
        yield by_position(question(chain, arm.straight, target, start))
    if len(arm.wrist) > 1:
        for wrist in product(*(turn.parts(_WRISTS) for turn in arm.wrist[:2])):
            yield by_position(question(chain, arm, target, start, wrist))


def ranked(found: Iterable[Vector], start: Vector) -> tuple[Vector, ...]:
    """Return the solutions (dof,) by distance to the start, each once."""
    kept: list[Vector] = []
    for q in sorted(found, key=lambda q: float((q - start) @ (q - start))):
        if not any(_same(q, other) for other in kept):
            kept.append(q)
    return tuple(kept)


def _same(a: Vector, b: Vector) -> bool:
    """Return whether two joint vectors (dof,) differ by full turns at most."""
    apart = a - b
    apart -= TURN_RAD * np.round(apart / TURN_RAD)
    return float(np.abs(apart).max()) < _ONE_SOLUTION_RAD


def start_of(chain: Chain, q0: ArrayLike | None) -> Vector:
    """Return q0 (dof,) checked, or the middle of the limits."""
    return chain.middle() if q0 is None else finite_vector(q0, chain.dof, "q0")
