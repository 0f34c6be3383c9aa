"""Control tables copied from the datasheets: one file a family, one row a register."""

from __future__ import annotations

from servosim.errors import UnknownModelError
from servosim.tables.dynamixel_1 import DYNAMIXEL_1
from servosim.tables.dynamixel_x import DYNAMIXEL_X
from servosim.tables.feetech_scs import FEETECH_SCS
from servosim.tables.feetech_sts import FEETECH_STS
from servosim.tables.register import Area, Family, Register, ServoTable, Sign

__all__ = ["TABLES", "Area", "Family", "Register", "ServoTable", "Sign", "table_for"]

TABLES: dict[str, ServoTable] = {
    table.model: table for table in (*DYNAMIXEL_X, *DYNAMIXEL_1, *FEETECH_STS, *FEETECH_SCS)
}


def table_for(model: str) -> ServoTable:
    """Return the table of a model; capitals do not matter.

    Raises:
        UnknownModelError: No table for such a model.
    """
    for name, table in TABLES.items():
        if name.lower() == model.lower():
            return table
    raise UnknownModelError(model, tuple(TABLES))
