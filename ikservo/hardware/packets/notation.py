"""Values, raw numbers and bytes: what may be written, decided before a byte is sent."""

from __future__ import annotations

import operator
from math import isfinite

from ikservo.errors import BadValueError, RegisterAccessError, UnknownNameError
from ikservo.hardware.servo import ServoSpec
from ikservo.registers import Access, Register, Role

__all__ = ["Wanted", "own_register", "to_bytes"]

Wanted = Register | Role
"""A register of any table, or a role that every table fills."""


def own_register(servo: ServoSpec, wanted: Wanted) -> Register:
    """Return the servo's own register for what is wanted.

    Raises:
        UnknownNameError: Its table has none of that name.
    """
    try:
        return servo.table.find(wanted)
    except UnknownNameError as error:
        error.add_note(f"while talking to {servo}")
        raise


def to_bytes(servo: ServoSpec, register: Register, value: float, *, raw: bool) -> bytes:
    """Return the bytes that write a value.

    Args:
        servo: Whose register it is, for messages.
        register: The servo's own register.
        value: In the register's unit, or its integer.
        raw: The value is the integer.

    Raises:
        RegisterAccessError: The register is read-only or the value does not fit.
    """
    if register.access is Access.RO:
        raise RegisterAccessError(str(servo), register.name, "it is read-only")
    number = _integer(servo, register, value) if raw else _count(servo, register, value)
    lower, upper = register.range
    if not lower <= number <= upper:
        raise RegisterAccessError(
            str(servo), register.name, f"{number} is outside {lower} to {upper}"
        )
    return register.encode(number)


def _integer(servo: ServoSpec, register: Register, value: float) -> int:
    try:
        return operator.index(value)  # pyright: ignore[reportArgumentType] (that is the question)
    except TypeError:
        raise BadValueError(f"The raw {register} of {servo}", value, "an integer") from None


def _count(servo: ServoSpec, register: Register, value: float) -> int:
    if not isfinite(value):
        raise RegisterAccessError(str(servo), register.name, f"{value} is not a number")
    return register.to_raw(value)
