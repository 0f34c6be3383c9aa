"""The method ``closed_form``: an answer without iteration, where the arm allows one."""

from __future__ import annotations

from functools import reduce

from ikservo.ik.answer import answer, closer
from ikservo.ik.bounded import bounded, kind_of, ready_for
from ikservo.ik.closed_form.closest import closed_form_seeds, closest
from ikservo.ik.closed_form.solutions import solutions
from ikservo.ik.options import Options
from ikservo.ik.result import Result
from ikservo.ik.target import Target
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Vector

__all__ = ["closed_form"]


def closed_form(chain: Chain, target: Target, q0: Vector, options: Options) -> Result:
    """Answer with the solution nearest the start, or the closest where that is known exactly.

    Where neither is known in closed form, ``bounded`` answers, starting from what the closed form
    comes near with, and the result says so.
    """
    idle = ready_for(chain, target).idle[kind_of(target)]

    def judged(q: Vector) -> Result:
        for joint in idle:
            q[joint.column] = joint.stays_at(float(q0[joint.column]))
        trace = (chain.clip(q0), q) if options.trace else ()
        return answer(
            chain, target, q, options.tolerance, method="closed_form", iterations=0, trace=trace
        )

    def better(best: Result, other: Result) -> Result:
        return other if closer(other, best, options.tolerance) else best

    nearest = tuple(map(judged, solutions(chain, target, q0)[:1]))
    if nearest and nearest[0].reached:
        return nearest[0]
    met_first = options.position_first is not False
    if met_first and (found := closest(chain, target, q0)):
        return reduce(better, map(judged, found))
    return bounded(chain, target, q0, options, closed_form_seeds(chain, target, q0))
