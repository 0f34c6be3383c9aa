"""Among several solutions the one nearest to the start.

A search goes to the solution that its steps lead to, which on six joints is the nearest in about
two cases of three. The closed form knows every solution; without one, walks from around the start
find most of those that are near.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ikservo.ik.answer import answer
from ikservo.ik.bounded import kind_of, question_of, ready_for
from ikservo.ik.closed_form import solutions, structure
from ikservo.ik.kernel.layout import REACHED
from ikservo.ik.options import Options
from ikservo.ik.preparing import Worker, kernel, settings_of
from ikservo.ik.result import Result
from ikservo.ik.target import Target
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["nearest"]

# Ways from the start that differ by less [rad] are equally long.
_SAME_RAD = 1e-6
# How far single joints are turned aside for another walk, and how many steps it has: a walk that
# has not come to a solution by then seldom does.
_ASIDE_RAD = 1.0
_STEPS = 20


def nearest(chain: Chain, target: Target, q0: Vector, options: Options, found: Result) -> Result:
    """Return a solution that is nearer to the start than the one found, or that one.

    Args:
        chain: The arm.
        target: What is wanted.
        q0: The start (dof,), rad or m, anywhere.
        options: What counts as reached.
        found: A solution.
    """
    idle = ready_for(chain, target).idle[kind_of(target)]
    best, way_rad = found, _way_rad(found.q, q0)
    for q in _others(chain, target, q0, options):
        for joint in idle:
            q[joint.column] = joint.stays_at(float(q0[joint.column]))
        if _way_rad(q, q0) < way_rad - _SAME_RAD:
            other = _judged(chain, target, q0, q, options, found)
            if other.reached:
                best, way_rad = other, _way_rad(q, q0)
    return best


def _others(chain: Chain, target: Target, q0: Vector, options: Options) -> Iterable[Vector]:
    if structure(chain, target.frame) is not None:
        return solutions(chain, target, q0)[:1]
    return _around(chain, target, q0, options)


def _around(chain: Chain, target: Target, q0: Vector, options: Options) -> Matrix:
    """Return the solutions (m, dof) that walks from around the start lead to."""
    aside = _ASIDE_RAD * np.eye(chain.dof)
    starts = np.ascontiguousarray(chain.clip(np.vstack([q0 + aside, q0 - aside])))
    kind, ready = kind_of(target), ready_for(chain, target)
    settings = settings_of(kind, chain.dof, _one_walk(options))
    worker = Worker(chain.dof, 1, questions=len(starts))
    worker.question[:] = question_of(target)
    search = kernel()
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


def _one_walk(options: Options) -> Options:
    return Options(
        options.tolerance,
        restarts=1,
        max_iterations=_STEPS,
        position_first=options.position_first,
        turn_weight_m_rad=options.turn_weight_m_rad,
    )


def _judged(
    chain: Chain, target: Target, q0: Vector, q: Vector, options: Options, found: Result
) -> Result:
    """Return the result of joints (dof,) that the search itself did not find."""
    exact = structure(chain, target.frame) is not None
    return answer(
        chain,
        target,
        q,
        options.tolerance,
        method="closed_form" if exact else found.method,
        iterations=0 if exact else found.iterations,
        trace=(chain.clip(q0), q) if options.trace else (),
    )


def _way_rad(q: Vector, q0: Vector) -> float:
    return float(np.linalg.norm(q - q0))
