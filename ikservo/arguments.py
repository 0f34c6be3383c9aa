"""Checks of the arguments that a program passes to an arm."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from typing import Literal, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import CONTROL, BadValueError, UnknownNameError, shown
from ikservo.kinematics import finite_vector
from ikservo.kinematics.arrays import LARGEST

T = TypeVar("T")

OnExit = Literal["hold", "relax"]
"""State in which ``close`` leaves an arm."""

_MIN_RATE_HZ, _MAX_RATE_HZ = 5.0, 1000.0  # a slower stream would exceed the dead-man timeout


def parse_all_positions(positions: object, names: Sequence[str]) -> dict[str, float]:
    """Parse joint positions that are given by name or as an array of all joints (n,).

    Raises:
        BadValueError: ``positions`` is neither a mapping nor an array of all joints.
    """
    if isinstance(positions, np.ndarray | list | tuple):
        array = finite_vector(cast("ArrayLike", positions), len(names), "The goal of all joints")
        return dict(zip(names, array.tolist(), strict=True))
    return parse_joint_positions(positions)


def check_callable(what: str, value: object) -> None:
    """Refuse a value that is neither None nor callable, before anything moves.

    Raises:
        BadValueError: The value is not callable.
    """
    if value is not None and not callable(value):
        raise BadValueError(what, shown(value), "a function, or None")


def check_choice(what: str, value: T, choices: Sequence[T]) -> T:
    """Check that a value is one of several choices, and return it.

    Raises:
        UnknownNameError: The value is not one of the choices.
    """
    # ``in`` with an array returns an array, which has no truth value.
    if isinstance(cast("object", value), np.ndarray) or value not in choices:
        raise UnknownNameError(what, value, [str(choice) for choice in choices])
    return value


def check_exit(on_exit: OnExit) -> OnExit:
    """Check the argument ``on_exit``, and return it.

    Raises:
        UnknownNameError: The value is neither ``hold`` nor ``relax``.
    """
    return check_choice("exit state", on_exit, ("hold", "relax"))


def check_iterable(what: str, value: object, expected: str) -> None:
    """Refuse a value that is not iterable.

    Raises:
        BadValueError: The value is not iterable.
    """
    if not isinstance(value, Iterable):
        raise BadValueError(what, shown(value), expected)


def parse_points(values: object) -> list[ArrayLike]:
    """Parse a sequence of points, from any iterable.

    Raises:
        BadValueError: An item is not a point.
    """
    try:
        if not isinstance(values, str | Mapping):
            return list(cast("Iterable[ArrayLike]", values))
    except TypeError:  # a single value, or an array without dimensions
        pass
    raise BadValueError("The list of points", shown(cast("object", values)), "points (k, 3)")


def parse_joint_positions(positions: object) -> dict[str, float]:
    """Parse joint positions as plain numbers by name.

    Raises:
        BadValueError: ``positions`` is not a mapping of names to numbers.
    """
    if not isinstance(positions, Mapping):
        raise BadValueError("The goal", shown(positions), 'positions by joint: {"elbow": 0.5}')
    given = cast("Mapping[object, object]", positions)
    return {
        parse_name("The name of a joint", name): parse_number(f"The goal of {name}", value)
        for name, value in given.items()
    }


def parse_number(what: str, value: object) -> float:
    """Convert a number to a float.

    Raises:
        BadValueError: The value is not a number; text and booleans are not accepted.
    """
    try:
        if isinstance(value, str | bytes | bytearray | bool | np.bool_):
            raise TypeError
        number = float(value)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError, OverflowError):
        raise BadValueError(what, shown(cast("object", value)), "a number") from None
    if math.isfinite(number) and abs(number) > LARGEST:
        raise BadValueError(what, number, f"a number within ±{LARGEST:g}")
    return number


def parse_period_s(rate_hz: object) -> float | None:
    """Convert a stream's rate to the time between two setpoints [s]; None if there is no rate.

    Raises:
        BadValueError: The rate [Hz] is not a number, or out of range.
    """
    if rate_hz is None:
        return None
    value_hz = parse_number("The rate", rate_hz)
    if not _MIN_RATE_HZ <= value_hz <= _MAX_RATE_HZ:
        expected = f"{_MIN_RATE_HZ:g} to {_MAX_RATE_HZ:g} Hz, or None"
        raise BadValueError("The rate", f"{value_hz:g} Hz", expected)
    return 1.0 / value_hz


def check_flag(what: str, value: object) -> bool:
    """Check that a value is True or False, and return it.

    Raises:
        BadValueError: The value is neither; 0 and 1, for example, are not accepted.
    """
    if not isinstance(value, bool | np.bool_):
        raise BadValueError(what, shown(value), "True or False")
    return bool(cast("object", value))


def parse_port(port: object) -> str | None:
    """Parse the name of a port; return None if no port is given.

    Raises:
        BadValueError: The value is neither a name nor a path.
    """
    if isinstance(port, os.PathLike):
        port = str(cast("os.PathLike[str]", port))
    if port is None or (isinstance(port, str) and not CONTROL.search(port)):
        return port
    raise BadValueError("The port", shown(port), "a name such as /dev/ttyACM0 or COM3, or sim")


def parse_name(what: str, name: object) -> str:
    """Check that a name is text, and return it.

    Raises:
        BadValueError: The value is not text.
    """
    if not isinstance(name, str):
        raise BadValueError(what, shown(name), "text")
    return name
