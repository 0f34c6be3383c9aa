"""The methods by name: same signature, same result, so that a person can compare them."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from ikservo.errors import UnknownNameError
from ikservo.ik.bounded import bounded
from ikservo.ik.options import Options
from ikservo.ik.result import Result
from ikservo.ik.target import Target
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Vector

__all__ = ["METHODS", "Method", "method_named"]

Method = Callable[[Chain, Target, Vector, Options], Result]
"""Chain, target, start (dof,) anywhere, options: an answer inside the limits."""

METHODS: Mapping[str, Method] = {
    "bounded": bounded,
}


def method_named(name: str) -> Method:
    """Return the method of that name; ``auto`` is the one that suits the arm.

    Raises:
        UnknownNameError: There is none; those that there are, are listed.
    """
    if name == "auto":
        return bounded
    if name not in METHODS:
        raise UnknownNameError("method", name, ("auto", *METHODS))
    return METHODS[name]
