"""The methods by name: same signature, same result, so that a person can compare them."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from ikservo.errors import UnknownNameError
from ikservo.ik.bounded import bounded
from ikservo.ik.ccd import ccd
from ikservo.ik.closed_form import closed_form_seeds, structure
from ikservo.ik.closed_form.method import closed_form
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
    """Answer in closed form where that is exact for the arm, else with ``bounded``.

    Where it is nearly exact it gives ``bounded`` its first starting points. A posture to lean
    towards, and a search that may not restart or leave its branch, are ``bounded``'s alone.
    """
    arm = structure(chain, target.frame)
    alone = options.track or options.restarts == 1 or options.posture is not None
    if arm is None or alone:
        return bounded(chain, target, q0, options)
    if arm.exact:
        return closed_form(chain, target, q0, options)
    return bounded(chain, target, q0, options, closed_form_seeds(chain, target, q0))


def method_named(name: str) -> Method:
    """Return the method of that name; ``auto`` is the one that suits the arm.

    Raises:
        UnknownNameError: There is none; those that there are, are listed.
    """
    if name == "auto":
        return auto
    if name not in METHODS:
        raise UnknownNameError("method", name, ("auto", *METHODS))
    return METHODS[name]
