"""Closed-form method: all solutions, their ranking and refinement."""

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

_STEPS = 6
_CONVERGED = 1e-10
# Singular values this far below the largest belong to rotations that move nothing.
_TRUNCATE = 1e-5


def refine_newton(chain: Chain, target: Target, q: Vector) -> Vector | None:
    """Compute the joints (dof,) near q that reach the target; None if the limits prevent it."""
    for _ in range(_STEPS):
        T, J = chain.forward_and_jacobian(q, target.frame, target.offset_m)
        E, rows = target.position - T[:3, 3], J[:3]
        if not target.only_position:
            E = np.concatenate([E, target.orientation_error(T[:3, :3])])
            rotations = J[3:]
            if target.rotation is None:  # rotations about a direction do not change it
                axis = T[:3, :3] @ target.axis
                rotations = rotations - np.outer(axis, axis @ rotations)
            rows = np.vstack([rows, rotations])
        if float(np.abs(E).max()) < _CONVERGED:
            return q
        q = _newton_update(chain, q, rows, E)
    return None


def _newton_update(chain: Chain, q: Vector, J: Matrix, E: Vector) -> Vector:
    """Return q + J⁺ E, computed without the joints that would leave their limits."""
    free = np.ones(chain.dof, dtype=np.bool_)
    while True:
        moved = q + np.linalg.pinv(J * free, rcond=_TRUNCATE) @ E
        leaving = free & ((moved < chain.lower_rad) | (moved > chain.upper_rad))
        if not leaving.any():
            return moved
        free &= ~leaving


# Two solutions this close [rad] are the same, found with different rounding.
_ONE_SOLUTION_RAD = 1e-7
# Wrist positions to try, as fractions of the ranges, if the start's own gives no solution.
_WRIST_SAMPLES = (0.5, 0.2, 0.8, 0.02, 0.98)
# Axes that are not quite parallel increase the orientation error by up to this factor, most of all
# near the yaw axis. Refinement decides between solutions.
_MISSED_PER_DEVIATION = 1e3


def solutions(chain: Chain, target: Target, q0: ArrayLike | None = None) -> tuple[Vector, ...]:
    """Compute joints (dof,) that reach the target, one for each branch, nearest to q0 first.

    If the target leaves freedom, each branch gives the solution nearest the start: the wrist keeps
    its position, and the last link its direction, as well as the limits allow. Angles that differ
    by full revolutions are one solution; the nearest to q0 is returned.

    Args:
        chain: The arm.
        target: The target.
        q0: The start (dof,), rad; the middle of the limits if None.

    Returns:
        Joints inside the limits; none if the target is out of reach, or if the arm has no closed
            form for this target (see ``recognise_structure``).

    Raises:
        BadValueError: q0 has a wrong shape or is not finite.
        UnknownNameError: The target's frame is not a link of the arm.
    """
    arm, start = recognise_structure(chain, target.frame), initial_joints(chain, q0)
    if arm is None:
        return ()
    found = approximate_solutions(chain, target, make_problem(chain, arm, target, start))
    if not arm.is_exact:
        found = [s for q in found if (s := refine_newton(chain, target, q)) is not None]
    return rank_by_distance(found, start)


def approximate_solutions(chain: Chain, target: Target, problem: AnalyticProblem) -> list[Vector]:
    """Compute the solutions of the recognised structure, in no particular order.

    They are exact solutions of the arm if the structure is exact.
    """
    if target.only_position:
        attempts = joined((solve_position(problem),), _with_another_wrist(chain, target, problem))
        return [c.q for c in next((found for found in attempts if found), ())]
    if len(problem.arm.wrist) < 2:
        met = 2.0 * ROUNDED + _MISSED_PER_DEVIATION * problem.arm.deviation
        return [candidate.q for candidate in solve_direction(problem) if candidate.miss < met]
    if problem.arm.orient is None:
        return []
    R_start = chain.forward(problem.start, target.frame)[:3, :3]
    for R in candidate_orientations(target, R_start):
        if found := list(solve_pose(problem, target, R)):
            return found
    return []


def _with_another_wrist(
    chain: Chain, target: Target, problem: AnalyticProblem
) -> Iterator[tuple[Candidate, ...]]:
    """Yield candidates for six joints whose wrist leaves its start position.

    The first candidates have the forearm's roll at zero, which gives three parallel links; the
    others have other wrist positions.
    """
    arm, start = problem.arm, problem.start
    if arm.with_wrist_locked:
        yield solve_position(make_problem(chain, arm.with_wrist_locked, target, start))
    if len(arm.wrist) > 1:
        for wrist in product(*(joint.sample_range(_WRIST_SAMPLES) for joint in arm.wrist[:2])):
            yield solve_position(make_problem(chain, arm, target, start, wrist))


def rank_by_distance(found: Iterable[Vector], start: Vector) -> tuple[Vector, ...]:
    """Sort the solutions (dof,) by distance from the start, and remove duplicates."""
    kept: list[Vector] = []
    for q in sorted(found, key=lambda q: float((q - start) @ (q - start))):
        if not any(_is_same_solution(q, other) for other in kept):
            kept.append(q)
    return tuple(kept)


def _is_same_solution(a: Vector, b: Vector) -> bool:
    """Check whether two joint vectors (dof,) differ by full revolutions at most."""
    apart = a - b
    apart -= FULL_TURN_RAD * np.round(apart / FULL_TURN_RAD)
    return float(np.abs(apart).max()) < _ONE_SOLUTION_RAD


def initial_joints(chain: Chain, q0: ArrayLike | None) -> Vector:
    """Check and return q0 (dof,); if it is None, return the middle of the limits."""
    return chain.mid_range() if q0 is None else finite_vector(q0, chain.dof, "q0")


def direction_intervals(
    chain: Chain, target: Target, q0: ArrayLike | None = None
) -> tuple[DirectionInterval, ...]:
    """Return every interval of last-link directions in which three links reach the target point.

    Args:
        chain: The arm.
        target: The target; only its point is used, not its direction or orientation.
        q0: The start (dof,), rad, for the wrist; the middle of the limits if None.

    Returns:
        The intervals of each yaw and elbow inside the limits; none if the point is out of reach or
        the arm has no three parallel joints. An arm whose joints are parallel only while the
        forearm does not roll keeps this roll at zero.
    """
    arm = recognise_structure(chain, target.frame)
    arm = arm.with_wrist_locked or arm if arm else None
    if arm is None or len(arm.plane.pivots) != 3:
        return ()
    problem = make_problem(chain, arm, target, initial_joints(chain, q0))
    links = arm.plane.links(problem.tip.in_plane_part(problem.start_roll))
    return tuple(
        DirectionInterval(yaw, elbow, arc.lower_rad, arc.upper_rad)
        for yaw in problem.yaws(problem.tip.normal_part(problem.start_roll))
        for elbow, arcs in enumerate(
            allowed_arcs(links, arm.plane.limits, problem.target_in_plane(yaw))
        )
        for arc in arcs
    )


def closest_solution(
    chain: Chain, target: Target, q0: ArrayLike | None = None
) -> tuple[Vector, ...]:
    """Find joints (dof,) that come closest to an unreachable target, if a closed form gives them.

    A planar arm moves its tip to the reachable point nearest the target. An arm whose wrist cannot
    help reaches the point and rotates the tool as far as the limits allow. The best solution is
    among the returned ones; all are inside the limits.
    """
    arm, start = recognise_structure(chain, target.frame), initial_joints(chain, q0)
    if arm is None or not arm.is_exact:
        return ()
    problem = make_problem(chain, arm, target, start)
    if arm.yaw is None:
        in_plane = [candidate.q for candidate in problem.planar_candidates(0.0, 0.0, bend=True)]
        return rank_by_distance(in_plane, start) or _nearest_stretched(problem, 0.0)
    if target.only_position or len(arm.wrist) > 1:
        return ()
    # Roll or yaw may be able to improve the direction at the cost of the point.
    amplitudes = [problem.tip.amplitude, *(aim.tool.amplitude for aim in problem.aims)]
    yaws = problem.point.angles_at_normal(problem.tip.normal_part(problem.start_roll))
    if yaws is None or max(amplitudes) > NO_FREEDOM:
        return ()
    return rank_by_distance((candidate.q for candidate in solve_position(problem)), start)


def analytic_seeds(chain: Chain, target: Target, q0: ArrayLike | None = None) -> tuple[Vector, ...]:
    """Return joints (dof,) inside the limits that are good starts for a search.

    They are the solutions of the recognised structure. If there are none, they are joints that
    reach the point in any orientation; if the point is out of reach, the links are stretched
    towards it.
    """
    arm, start = recognise_structure(chain, target.frame), initial_joints(chain, q0)
    if arm is None:
        return ()
    problem = make_problem(chain, arm, target, start)
    found = approximate_solutions(chain, target, problem) or [c.q for c in solve_position(problem)]
    if found:
        return rank_by_distance(found, start)
    yaws = tuple(problem.yaws(problem.tip.normal_part(problem.start_roll))) or (problem.start_yaw,)
    return tuple(q for yaw in yaws for q in _nearest_stretched(problem, yaw)[:1])


def _nearest_stretched(problem: AnalyticProblem, yaw: float) -> tuple[Vector, ...]:
    """Return the joints (dof,) whose planar links come nearest to the target point, best first."""
    plane = problem.arm.plane
    found = nearest_planar_angles(
        plane.links(problem.tip.in_plane_part(problem.start_roll)),
        plane.limits,
        problem.target_in_plane(yaw),
        plane.angles(problem.start),
    )
    return tuple(problem.joints(yaw, angles, (problem.start_roll,)) for angles in found)


def closed_form(chain: Chain, target: Target, q0: Vector, options: Options) -> Result:
    """Return the solution nearest the start, or the closest posture if that is known exactly.

    Otherwise ``bounded`` searches from the nearest closed-form postures; ``method`` is "bounded".
    """
    idle = problem_for_target(chain, target).idle[target_kind_of(target)]

    def evaluated(q: Vector) -> Result:
        for joint in idle:
            q[joint.column] = joint.resting_position(float(q0[joint.column]))
        trace = (chain.clip(q0), q) if options.trace else ()
        return evaluate(
            chain, target, q, options.tolerance, method="closed_form", iterations=0, trace=trace
        )

    def better(best: Result, other: Result) -> Result:
        return other if is_closer(other, best, options.tolerance) else best

    nearest = tuple(map(evaluated, solutions(chain, target, q0)[:1]))
    if nearest and nearest[0].reached:
        return nearest[0]
    met_first = options.position_first is not False
    if met_first and (found := closest_solution(chain, target, q0)):
        return reduce(better, map(evaluated, found))
    return bounded(chain, target, q0, options, analytic_seeds(chain, target, q0))
