"""All control tables, by model name."""

from __future__ import annotations

from servosim.errors import UnknownModelError
from servosim.register import ServoTable, Sign, SimulatedArea, SimulatedFamily, SimulatedRegister
from servosim.tables_dynamixel import DYNAMIXEL_1, DYNAMIXEL_X
from servosim.tables_feetech import FEETECH_SCS, FEETECH_STS

__all__ = [
    "TABLES",
    "ServoTable",
    "Sign",
    "SimulatedArea",
    "SimulatedFamily",
    "SimulatedRegister",
    "table_for",
]

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
