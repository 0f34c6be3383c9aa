"""Among several solutions, find the one nearest to the start.

A search goes to the solution that its steps lead to, which on six joints is the nearest in about
two cases of three. The closed form knows every solution; without one, walks from around the start
find most of those that are near.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ikservo.ik.bounded import pack_target, problem_for_target, target_kind_of
from ikservo.ik.closed_form import solutions
from ikservo.ik.closed_form_structure import recognise_structure
from ikservo.ik.evaluation import evaluate
from ikservo.ik.kernel.layout import REACHED
from ikservo.ik.prepare import SolverBuffers, load_kernel, pack_settings
from ikservo.ik.problem import Options, Target
from ikservo.ik.result import Result
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector

__all__ = ["nearest_solution"]

# Ways from the start that differ by less [rad] are equally long.
_SAME_RAD = 1e-6
# How far single joints are turned aside for another walk, and how many steps it has: a walk that
# has not come to a solution by then seldom does.
_START_OFFSET_RAD = 1.0
_STEPS = 20


def nearest_solution(
    chain: Chain, target: Target, q0: Vector, options: Options, found: Result
) -> Result:
    """Return a solution that is nearer to the start than the one found, or that one.

    Args:
        chain: The arm.
        target: What is wanted.
        q0: The start (dof,), rad or m, anywhere.
        options: What counts as reached.
        found: A solution.
    """
    idle = problem_for_target(chain, target).idle[target_kind_of(target)]
    best, way_rad = found, _joint_distance_rad(found.q, q0)
    for q in _other_solutions(chain, target, q0, options):
        for joint in idle:
            q[joint.column] = joint.resting_position(float(q0[joint.column]))
        if _joint_distance_rad(q, q0) < way_rad - _SAME_RAD:
            other = _make_result(chain, target, q0, q, options, found)
            if other.reached:
                best, way_rad = other, _joint_distance_rad(q, q0)
    return best


def _other_solutions(
    chain: Chain, target: Target, q0: Vector, options: Options
) -> Iterable[Vector]:
    if recognise_structure(chain, target.frame) is not None:
        return solutions(chain, target, q0)[:1]
    return _solutions_around(chain, target, q0, options)


def _solutions_around(chain: Chain, target: Target, q0: Vector, options: Options) -> Matrix:
    """Return the solutions (m, dof) that walks from around the start lead to."""
    aside = _START_OFFSET_RAD * np.eye(chain.dof)
    starts = np.ascontiguousarray(chain.clip(np.vstack([q0 + aside, q0 - aside])))
    kind, ready = target_kind_of(target), problem_for_target(chain, target)
    settings = pack_settings(kind, chain.dof, _single_start_options(options))
    worker = SolverBuffers(chain.dof, 1, questions=len(starts))
    worker.question[:] = pack_target(target)
    search = load_kernel()
    search(
        ready.arm,
        worker.question,
        settings,
        starts,
        ready.seeds,
        worker.desk,
        worker.trace,
        worker.answer,
    )
    reached = worker.answer[:, 2 * chain.dof + REACHED] == 1.0
    return worker.answer[reached, : chain.dof]


def _single_start_options(options: Options) -> Options:
    return Options(
        options.tolerance,
        restarts=1,
        max_iterations=_STEPS,
        position_first=options.position_first,
        turn_weight_m_rad=options.turn_weight_m_rad,
    )


def _make_result(
    chain: Chain, target: Target, q0: Vector, q: Vector, options: Options, found: Result
) -> Result:
    """Return the result of joints (dof,) that the search itself did not find."""
    exact = recognise_structure(chain, target.frame) is not None
    return evaluate(
        chain,
        target,
        q,
        options.tolerance,
        method="closed_form" if exact else found.method,
        iterations=0 if exact else found.iterations,
        trace=(chain.clip(q0), q) if options.trace else (),
    )


def _joint_distance_rad(q: Vector, q0: Vector) -> float:
    return float(np.linalg.norm(q - q0))
