"""What a program hands to an arm, looked at before anything else is done with it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import cast

from ikservo.errors import BadValueError

__all__ = ["joint_positions", "number", "port_name"]


def joint_positions(positions: object) -> dict[str, float]:
    """Return joint positions as plain numbers by name.

    Raises:
        BadValueError: They are no mapping of names to numbers.
    """
    if not isinstance(positions, Mapping):
        raise BadValueError("The goal", repr(positions), 'positions by joint: {"elbow": 0.5}')
    given = cast("Mapping[object, object]", positions)
    return {_name(name): number(f"The goal of {name}", value) for name, value in given.items()}


def number(what: str, value: object) -> float:
    """Return a number as a float.

    Raises:
        BadValueError: It is none; text that reads like one is none either.
    """
    try:
        if isinstance(value, str | bytes | bytearray):
            raise TypeError
        return float(value)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError, OverflowError):
        raise BadValueError(what, repr(value), "a number") from None


def port_name(port: object) -> str | None:
    """Return the name of a port, or None where none is given.

    Raises:
        BadValueError: It is neither a name nor a path.
    """
    if port is None or isinstance(port, str):
        return port
    if isinstance(port, os.PathLike):
        return str(cast("os.PathLike[str]", port))
    raise BadValueError("The port", repr(port), "a name such as /dev/ttyACM0 or COM3, or sim")


def _name(name: object) -> str:
    if not isinstance(name, str):
        raise BadValueError("The name of a joint", repr(name), "text")
    return name
