"""The catalogue of servo models."""

from __future__ import annotations

from collections.abc import Mapping

from ikservo.errors import UnknownNameError
from ikservo.registers.control_table import ControlTable, Family
from ikservo.registers.dynamixel_1 import AX12A, MX28
from ikservo.registers.dynamixel_x import XL330M077, XL330M288, XL430W250, XM430W350, XM540W270
from ikservo.registers.feetech_scs import SCS0009, SCS15
from ikservo.registers.feetech_sts import STS3215, STS3250

__all__ = ["MODELS", "control_table", "control_table_for_number"]

# fmt: off
_TABLES: tuple[type[ControlTable], ...] = (
    STS3215, STS3250,
    SCS0009, SCS15,
    XL330M288, XL330M077, XL430W250, XM430W350, XM540W270,
    AX12A, MX28,
)
# fmt: on
MODELS: Mapping[str, type[ControlTable]] = {table.model_name: table for table in _TABLES}
"""Every known model by its name."""


def control_table(model_name: str) -> type[ControlTable]:
    """Return the table of a servo model.

    Raises:
        UnknownNameError: No such model; the closest name is offered.
    """
    if model_name not in MODELS:
        raise UnknownNameError("servo model", model_name, MODELS)
    return MODELS[model_name]


def control_table_for_number(family: Family, number: int) -> type[ControlTable] | None:
    """Return the table of the model that reports a number, or None where none is known."""
    found = (t for t in _TABLES if t.family is family and t.number == number)
    return next(found, None)
