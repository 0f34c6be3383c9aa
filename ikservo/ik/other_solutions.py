"""Other solutions for a target: their number or family, and the solution nearest to the start.

A search converges to one solution; with six joints, this is the nearest solution in about two out
of three cases. The closed form has every solution; without it, searches that begin around the start
find most of the near solutions.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from ikservo.ik.bounded import problem_for_target, target_kind_of
from ikservo.ik.closed_form import direction_intervals, solutions
from ikservo.ik.closed_form_structure import recognise_structure
from ikservo.ik.jacobian_methods import ResidualFunction, pinv
from ikservo.ik.prepare import SolverBuffers, load_kernel, pack_settings
from ikservo.ik.problem import Options, Target, Tolerance
from ikservo.ik.result import Result, SolutionSet, evaluate
from ikservo.kernels.layout import REACHED
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.conditioning import ordinary_postures

# Singular values below these fractions of the largest are zero.
_RANK = 1e-7  # at any posture
_SINGULAR = 1e-6  # at a solution
# To test whether a solution has neighbours, the joints are offset from it and solved again; if the
# solution is isolated, they return to it.
_OFFSET_RAD = 0.02  # the offset, rad or m
_STEPS = 10  # steps of the second solve
_MIN_OFFSET_FRACTION = 0.5  # fraction of the offset that remains at a neighbour
_REVOLUTION_RAD = 2.0 * np.pi
_SAME_RAD = 1e-4  # joints of one solution differ by less, rad or m

# Distances from the start that differ by less [rad] are equal.
_SAME_LENGTH_RAD = 1e-6
_START_OFFSET_RAD = 1.0  # offset of single joints for another search
_NEARBY_STEPS = 20  # steps of such a search; if it has not converged by then, it rarely does


def solution_set(
    chain: Chain, target: Target, q: Vector, tolerance: Tolerance | None = None
) -> SolutionSet:
    """Return the number or family of the solutions of a target that joints (dof,) reach."""
    task, tolerance = ResidualFunction(chain, target), tolerance or Tolerance()
    current = task.linearise(q)
    if not task.is_met(current, Tolerance(2 * tolerance.position_m, 2 * tolerance.orientation_rad)):
        return SolutionSet("none", 0)
    idle = problem_for_target(chain, target).idle[target_kind_of(target)]
    idle_columns = {joint.column for joint in idle}
    moving = [column for column in range(chain.dof) if column not in idle_columns]
    jacobians = [task.linearise(each).J[:, moving] for each in ordinary_postures(chain.dof)]
    usual_rank = max(_numerical_rank(each, _RANK) for each in jacobians)
    J = current.J[:, moving]
    # The directions (k, n) in which joints move without moving the target point.
    null_directions = np.linalg.svd(J)[2][_numerical_rank(J, _SINGULAR) :]
    is_known = recognise_structure(chain, target.frame) is not None
    if any(
        _continues_along(task, tolerance, q, moving, direction)
        for direction in (*null_directions, *-null_directions)
    ):
        free = max(len(moving) - usual_rank, 1)
        is_planar_3r = target.only_position and free == 1 and is_known
        directions = direction_intervals(chain, target, q) if is_planar_3r else ()
        return SolutionSet("family", len(directions) or None, free, directions)
    known = solutions(chain, target, q) if is_known else ()
    if not known:
        return SolutionSet("unknown")
    apart = np.array(known) - q
    apart -= _REVOLUTION_RAD * np.round(apart / _REVOLUTION_RAD)
    if not (np.abs(apart).max(axis=1) < _SAME_RAD).any():
        return SolutionSet("several")  # the closed form does not give all solutions of the family
    return SolutionSet("one" if len(known) == 1 else "several", len(known))


def _numerical_rank(J: Matrix, tolerance_ratio: float) -> int:
    values = np.linalg.svd(J, compute_uv=False)
    return int((values > tolerance_ratio * values.max(initial=0.0)).sum())


def _continues_along(
    task: ResidualFunction, tolerance: Tolerance, q: Vector, moving: list[int], direction: Vector
) -> bool:
    """Check whether there are solutions next to q along a direction (n,) of the moving joints."""
    chain, nearby = task.chain, q.copy()
    nearby[moving] += _OFFSET_RAD * direction
    nearby = chain.clip(nearby)
    for _ in range(_STEPS):
        local = task.linearise(nearby)
        free = np.zeros(chain.dof, dtype=np.bool_)
        free[moving] = True
        free &= (nearby > chain.lower_rad) & (nearby < chain.upper_rad)
        step = np.zeros(chain.dof)
        step[free] = pinv(local.J[:, free], _SINGULAR) @ local.E
        nearby = chain.clip(nearby + step)
    aside = float((nearby[moving] - q[moving]) @ direction)
    return (
        task.is_met(task.linearise(nearby), tolerance)
        and aside > _MIN_OFFSET_FRACTION * _OFFSET_RAD
    )


def nearest_solution(
    chain: Chain, target: Target, q0: Vector, options: Options, found: Result
) -> Result:
    """Return a solution that is nearer to the start (dof,) than ``found``, or else ``found``.

    The start, rad or m, may be outside the limits.
    """
    idle = problem_for_target(chain, target).idle[target_kind_of(target)]
    best, distance_rad = found, _joint_distance_rad(found.q, q0)
    exact = recognise_structure(chain, target.frame) is not None
    others: Iterable[Vector] = (
        solutions(chain, target, q0)[:1] if exact else _solutions_around(chain, target, q0, options)
    )
    for q in others:
        for joint in idle:
            q[joint.column] = joint.resting_position(float(q0[joint.column]))
        if _joint_distance_rad(q, q0) < distance_rad - _SAME_LENGTH_RAD:
            other = evaluate(
                chain,
                target,
                q,
                options.tolerance,
                method="closed_form" if exact else found.method,
                iterations=0 if exact else found.iterations,
                trace=(chain.clip(q0), q) if options.trace else (),
            )
            if other.reached:
                best, distance_rad = other, _joint_distance_rad(q, q0)
    return best


def _solutions_around(chain: Chain, target: Target, q0: Vector, options: Options) -> Matrix:
    """Compute the solutions (m, dof) of searches that begin around the start."""
    aside = _START_OFFSET_RAD * np.eye(chain.dof)
    starts = np.ascontiguousarray(chain.clip(np.vstack([q0 + aside, q0 - aside])))
    kind, ready = target_kind_of(target), problem_for_target(chain, target)
    single_start = replace(options, restarts=1, max_iterations=_NEARBY_STEPS, track=False)
    settings = pack_settings(kind, chain.dof, single_start)
    worker = SolverBuffers(chain.dof, 1, questions=len(starts))
    worker.question[:] = target.packed.ravel()
    search = load_kernel()
    search(
        ready.arm,
        worker.question,
        settings,
        starts,
        ready.seeds,
        worker.work,
        worker.scores,
        worker.trace,
        worker.answer,
    )
    reached = worker.answer[:, 2 * chain.dof + REACHED] == 1.0
    return worker.answer[reached, : chain.dof]


def _joint_distance_rad(q: Vector, q0: Vector) -> float:
    return float(np.linalg.norm(q - q0))
