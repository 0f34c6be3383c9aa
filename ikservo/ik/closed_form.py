"""The closed-form method: all solutions, their ranking and refinement."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import reduce
from itertools import chain as joined
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from ikservo.ik.bounded import bounded, problem_for_target, target_kind_of
from ikservo.ik.closed_form_problem import AnalyticProblem, Candidate, make_problem
from ikservo.ik.closed_form_structure import recognise_structure
from ikservo.ik.planar import DirectionInterval, allowed_arcs, nearest_planar_angles
from ikservo.ik.problem import Options, Target
from ikservo.ik.result import Result, evaluate, is_closer
from ikservo.ik.subproblems import FULL_TURN_RAD, NO_FREEDOM, ROUNDED
from ikservo.ik.wrist import candidate_orientations, solve_direction, solve_pose, solve_position
from ikservo.kinematics import Chain, finite_vector
from ikservo.kinematics.arrays import Matrix, Vector

__all__ = [
    "analytic_seeds",
    "approximate_solutions",
    "closed_form",
    "closest_solution",
    "direction_intervals",
    "initial_joints",
    "rank_by_distance",
    "refine_newton",
    "solutions",
]


_STEPS = 6
_CONVERGED = 1e-10
# Singular values this much below the largest belong to turns that move nothing.
_TRUNCATE = 1e-5


def refine_newton(chain: Chain, target: Target, q: Vector) -> Vector | None:
    """Return the joints (dof,) near q that meet the target, None if the limits are in the way."""
    for _ in range(_STEPS):
        T, J = chain.forward_and_jacobian(q, target.frame, target.offset_m)
        E, rows = target.position - T[:3, 3], J[:3]
        if not target.only_position:
            E = np.concatenate([E, target.orientation_error(T[:3, :3])])
            rows = np.vstack([rows, _rotation_rows(J[3:], T, target)])
        if float(np.abs(E).max()) < _CONVERGED:
            return q
        q = _newton_update(chain, q, rows, E)
    return None


def _newton_update(chain: Chain, q: Vector, J: Matrix, E: Vector) -> Vector:
    """Return q + J⁺ E, without the joints that would leave their limits (lecture L8, L9)."""
    free = np.ones(chain.dof, dtype=np.bool_)
    while True:
        moved = q + np.linalg.pinv(J * free, rcond=_TRUNCATE) @ E
        leaving = free & ((moved < chain.lower_rad) | (moved > chain.upper_rad))
        if not leaving.any():
            return moved
        free &= ~leaving


def _rotation_rows(angular: Matrix, T: Matrix, target: Target) -> Matrix:
    """Return the rows that turn the tool; a wanted direction does not care for turns about it."""
    if target.rotation is not None:
        return angular
    axis = T[:3, :3] @ target.axis
    return angular - np.outer(axis, axis @ angular)


# Two solutions this near [rad] are one, met by rounding from two sides.
_ONE_SOLUTION_RAD = 1e-7
# Wrists to try, as parts of the ranges, where the start's own does not reach.
_WRIST_SAMPLES = (0.5, 0.2, 0.8, 0.02, 0.98)
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
    arm, start = recognise_structure(chain, target.frame), initial_joints(chain, q0)
    if arm is None:
        return ()
    found = approximate_solutions(chain, target, make_problem(chain, arm, target, start))
    if not arm.is_exact:
        found = [s for q in found if (s := refine_newton(chain, target, q)) is not None]
    return rank_by_distance(found, start)


def approximate_solutions(chain: Chain, target: Target, asked: AnalyticProblem) -> list[Vector]:
    """Return the solutions of the recognised structure, in no order.

    They are the arm's own where the structure is exact.
    """
    if target.only_position:
        attempts = joined((solve_position(asked),), _with_another_wrist(chain, target, asked))
        return [c.q for c in next((found for found in attempts if found), ())]
    if len(asked.arm.wrist) < 2:
        met = 2.0 * ROUNDED + _MISSED_PER_DEVIATION * asked.arm.deviation
        return [candidate.q for candidate in solve_direction(asked) if candidate.miss < met]
    if asked.arm.orient is None:
        return []
    R_start = chain.forward(asked.start, target.frame)[:3, :3]
    for R in candidate_orientations(target, R_start):
        if found := list(solve_pose(asked, target, R)):
            return found
    return []


def _with_another_wrist(
    chain: Chain, target: Target, asked: AnalyticProblem
) -> Iterator[tuple[Candidate, ...]]:
    """Yield what six joints reach when the wrist does not stay as at the start.

    First the forearm's roll at zero makes three parallel links, then a few wrists are tried.
    """
    arm, start = asked.arm, asked.start
    if arm.with_wrist_locked:
        yield solve_position(make_problem(chain, arm.with_wrist_locked, target, start))
    if len(arm.wrist) > 1:
        for wrist in product(*(turn.sample_range(_WRIST_SAMPLES) for turn in arm.wrist[:2])):
            yield solve_position(make_problem(chain, arm, target, start, wrist))


def rank_by_distance(found: Iterable[Vector], start: Vector) -> tuple[Vector, ...]:
    """Return the solutions (dof,) by distance to the start, each once."""
    kept: list[Vector] = []
    for q in sorted(found, key=lambda q: float((q - start) @ (q - start))):
        if not any(_is_same_solution(q, other) for other in kept):
            kept.append(q)
    return tuple(kept)


def _is_same_solution(a: Vector, b: Vector) -> bool:
    """Return whether two joint vectors (dof,) differ by full turns at most."""
    apart = a - b
    apart -= FULL_TURN_RAD * np.round(apart / FULL_TURN_RAD)
    return float(np.abs(apart).max()) < _ONE_SOLUTION_RAD


def initial_joints(chain: Chain, q0: ArrayLike | None) -> Vector:
    """Return q0 (dof,) checked, or the middle of the limits."""
    return chain.mid_range() if q0 is None else finite_vector(q0, chain.dof, "q0")


def direction_intervals(
    chain: Chain, target: Target, q0: ArrayLike | None = None
) -> tuple[DirectionInterval, ...]:
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
    arm = recognise_structure(chain, target.frame)
    arm = arm.with_wrist_locked or arm if arm else None
    if arm is None or len(arm.plane.pivots) != 3:
        return ()
    asked = make_problem(chain, arm, target, initial_joints(chain, q0))
    links = arm.plane.links(asked.tip.in_plane_part(asked.start_roll))
    return tuple(
        DirectionInterval(yaw, elbow, arc.lower_rad, arc.upper_rad)
        for yaw in asked.yaws(asked.tip.normal_part(asked.start_roll))
        for elbow, arcs in enumerate(
            allowed_arcs(links, arm.plane.limits, asked.target_in_plane(yaw))
        )
        for arc in arcs
    )


def closest_solution(
    chain: Chain, target: Target, q0: ArrayLike | None = None
) -> tuple[Vector, ...]:
    """Return joints (dof,) that come as close to an unreachable target as any, if that is known.

    Known in closed form are the nearest point of a planar arm, and the nearest direction of an
    arm whose wrist cannot help: it meets the point, and turns the tool as far as the limits go.
    The best is among what is returned; all of it is inside the limits.
    """
    arm, start = recognise_structure(chain, target.frame), initial_joints(chain, q0)
    if arm is None or not arm.is_exact:
        return ()
    asked = make_problem(chain, arm, target, start)
    if arm.yaw is None:
        in_plane = [candidate.q for candidate in asked.planar_candidates(0.0, 0.0, bend=True)]
        return rank_by_distance(in_plane, start) or _nearest_stretched(asked, 0.0)
    if target.only_position or len(arm.wrist) > 1 or _has_redundancy(asked):
        return ()
    return rank_by_distance((candidate.q for candidate in solve_position(asked)), start)


def _has_redundancy(asked: AnalyticProblem) -> bool:
    """Return whether roll or yaw can trade the point against the direction."""
    sways = [aim.tool.amplitude for aim in asked.aims]
    on_yaw_axis = asked.point.angles_at_normal(asked.tip.normal_part(asked.start_roll)) is None
    return on_yaw_axis or max(sways, default=0.0) > NO_FREEDOM or asked.tip.amplitude > NO_FREEDOM


def analytic_seeds(chain: Chain, target: Target, q0: ArrayLike | None = None) -> tuple[Vector, ...]:
    """Return joints (dof,) inside the limits that are good starts for a search.

    They are the solutions of the recognised structure, where there are none the joints that meet
    the point alone, and where the point is out of reach the links stretched towards it.
    """
    arm, start = recognise_structure(chain, target.frame), initial_joints(chain, q0)
    if arm is None:
        return ()
    asked = make_problem(chain, arm, target, start)
    found = approximate_solutions(chain, target, asked) or [c.q for c in solve_position(asked)]
    if found:
        return rank_by_distance(found, start)
    yaws = tuple(asked.yaws(asked.tip.normal_part(asked.start_roll))) or (asked.start_yaw,)
    return tuple(q for yaw in yaws for q in _nearest_stretched(asked, yaw)[:1])


def _nearest_stretched(asked: AnalyticProblem, yaw: float) -> tuple[Vector, ...]:
    """Return the joints whose planar links come nearest, best first."""
    plane = asked.arm.plane
    found = nearest_planar_angles(
        plane.links(asked.tip.in_plane_part(asked.start_roll)),
        plane.limits,
        asked.target_in_plane(yaw),
        plane.angles(asked.start),
    )
    return tuple(asked.joints(yaw, angles, (asked.start_roll,)) for angles in found)


def closed_form(chain: Chain, target: Target, q0: Vector, options: Options) -> Result:
    """Answer with the solution nearest the start, or the closest where that is known exactly.

    Where neither is known in closed form, ``bounded`` answers, starting from what the closed form
    comes near with, and the result says so.
    """
    idle = problem_for_target(chain, target).idle[target_kind_of(target)]

    def judged(q: Vector) -> Result:
        for joint in idle:
            q[joint.column] = joint.resting_position(float(q0[joint.column]))
        trace = (chain.clip(q0), q) if options.trace else ()
        return evaluate(
            chain, target, q, options.tolerance, method="closed_form", iterations=0, trace=trace
        )

    def better(best: Result, other: Result) -> Result:
        return other if is_closer(other, best, options.tolerance) else best

    nearest = tuple(map(judged, solutions(chain, target, q0)[:1]))
    if nearest and nearest[0].reached:
        return nearest[0]
    met_first = options.position_first is not False
    if met_first and (found := closest_solution(chain, target, q0)):
        return reduce(better, map(judged, found))
    return bounded(chain, target, q0, options, analytic_seeds(chain, target, q0))
