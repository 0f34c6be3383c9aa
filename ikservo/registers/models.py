"""The catalogue of servo models."""

from __future__ import annotations

from collections.abc import Mapping

from ikservo.errors import UnknownNameError
from ikservo.registers import dynamixel_1, dynamixel_x, feetech_scs, feetech_sts
from ikservo.registers.control_table import ControlTable, Family

_TABLES = (*feetech_sts.TABLES, *feetech_scs.TABLES, *dynamixel_x.TABLES, *dynamixel_1.TABLES)
MODELS: Mapping[str, type[ControlTable]] = {table.model_name: table for table in _TABLES}
"""Every known model by its name."""


def control_table(model_name: str) -> type[ControlTable]:
    """Return the table of a servo model.

    Raises:
        UnknownNameError: There is no such model; the closest name is suggested.
    """
    if model_name not in MODELS:
        raise UnknownNameError("servo model", model_name, MODELS)
    return MODELS[model_name]


def control_table_for_number(family: Family, number: int) -> type[ControlTable] | None:
    """Return the table of the model that reports a number, or None if it is unknown."""
    found = (t for t in _TABLES if t.family is family and t.number == number)
    return next(found, None)
