"""The methods by name: same signature, same result, so that a person can compare them."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from ikservo.errors import UnknownNameError
from ikservo.ik.answer import closer
from ikservo.ik.bounded import bounded
from ikservo.ik.ccd import ccd
from ikservo.ik.closed_form import structure
from ikservo.ik.closed_form.method import closed_form
from ikservo.ik.nearest import nearest
from ikservo.ik.options import Options
from ikservo.ik.pseudo_inverse import pseudo_inverse
from ikservo.ik.result import Result
from ikservo.ik.target import Target
from ikservo.ik.transpose import transpose
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Vector

__all__ = ["METHODS", "Method", "method_named"]

Method = Callable[[Chain, Target, Vector, Options], Result]
"""Chain, target, start (dof,) anywhere, options: an answer inside the limits."""

METHODS: Mapping[str, Method] = {
    "bounded": bounded,
    "closed_form": closed_form,
    "pseudo_inverse": pseudo_inverse,
    "transpose": transpose,
    "ccd": ccd,
}


def auto(chain: Chain, target: Target, q0: Vector, options: Options) -> Result:
    """Ask ``bounded``, which is compiled; where it finds no way, ask the closed form besides.

    What it finds is exchanged for a solution nearer to the start, where one is known or found.

    A search that may not restart or leave its branch is ``bounded``'s alone. Towards a posture
    ``pseudo_inverse`` goes on from the solution.
    """
    found = bounded(chain, target, q0, options)
    if found.reached and options.posture is not None and not options.track:
        leaning = pseudo_inverse(chain, target, found.q, options)
        return leaning if leaning.reached else found
    alone = options.track or options.restarts == 1
    if found.reached and options.nearest and not alone:
        return nearest(chain, target, q0, options, found)
    if found.reached or alone or structure(chain, target.frame) is None:
        return found
    formula = closed_form(chain, target, q0, options)
    return formula if closer(formula, found, options.tolerance) else found


def method_named(name: str) -> Method:
    """Return the method of that name; ``auto`` is the one that suits the arm.

    Raises:
        UnknownNameError: There is none; those that there are, are listed.
    """
    if name == "auto":
        return auto
    if str(name) not in METHODS:
        raise UnknownNameError("method", name, ("auto", *METHODS))
    return METHODS[name]
