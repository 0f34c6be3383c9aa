"""Signatures of methods that accept options as a ``TypedDict`` and points as numbers."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import fields
from functools import wraps
from numbers import Real
from typing import Any, TypeVar, cast

from ikservo.errors import BadValueError
from ikservo.planning.motions import MotionValue

F = TypeVar("F", bound=Callable[..., Any])


def with_options(
    kind: type[MotionValue[Any]], options: object, *, takes_point: bool = False
) -> Callable[[F], F]:
    """Return a decorator that makes ``help`` list the options of a method with their defaults.

    With ``takes_point``, the method accepts a point (3,) also as three numbers.
    """
    names = inspect.get_annotations(cast("Any", options))
    defaults = {each.name: each.default for each in fields(cast("Any", kind))}

    def decorate(method: F) -> F:
        signature = inspect.signature(method)
        parameters = list(signature.parameters.values())[:-1]
        for name in names:
            if name != "on_progress" or "wait" in signature.parameters:
                default = defaults.get(name)
                if not isinstance(default, str | float | bool | None):
                    default = _Default()
                keyword = inspect.Parameter.KEYWORD_ONLY
                parameters.append(inspect.Parameter(name, keyword, default=default))

        @wraps(method)
        def run(self: Any, *args: Any, **given: Any) -> Any:  # noqa: ANN401  # of any method
            if takes_point and len(args) > 1:  # x, y, z as three arguments
                if len(args) != 3 or not all(isinstance(each, Real) for each in args):
                    expected = "(x, y, z) in metres, and options by name"
                    raise BadValueError("The point", f"{args}", expected)
                args = (args,)
            return method(self, *args, **given)

        cast("Any", run).__signature__ = signature.replace(parameters=parameters)
        return cast("F", run)

    return decorate


class _Default:
    """Short form of the default of an option whose value has many fields."""

    def __repr__(self) -> str:
        return "<default>"
