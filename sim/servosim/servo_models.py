"""Servos by model name: control tables, and the firmware of each family."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

from servosim.dynamixel_1 import BAUDS_320, Dynamixel1
from servosim.dynamixel_x import SimulatedDynamixelX
from servosim.errors import SimulatorError, UnknownModelError
from servosim.feetech import Feetech
from servosim.feetech_models import ScsSeries, StsSeries
from servosim.motor import Motor
from servosim.register import ServoTable, SimulatedFamily
from servosim.servo import HornMounting, Servo
from servosim.tables_dynamixel import DYNAMIXEL_1, DYNAMIXEL_X
from servosim.tables_feetech import FEETECH_SCS, FEETECH_STS

TABLES: dict[str, ServoTable] = {
    table.model: table for table in (*DYNAMIXEL_X, *DYNAMIXEL_1, *FEETECH_STS, *FEETECH_SCS)
}

_FIRMWARE: dict[SimulatedFamily, Callable[..., Servo]] = {
    SimulatedFamily.DYNAMIXEL_X: SimulatedDynamixelX,
    SimulatedFamily.DYNAMIXEL_1: Dynamixel1,
    SimulatedFamily.DYNAMIXEL_320: Dynamixel1,
    SimulatedFamily.FEETECH_STS: partial(Feetech, StsSeries),
    SimulatedFamily.FEETECH_SCS: partial(Feetech, ScsSeries),
}
_BAUDS: dict[SimulatedFamily, Mapping[int, float]] = {
    SimulatedFamily.DYNAMIXEL_X: SimulatedDynamixelX.bauds,
    SimulatedFamily.DYNAMIXEL_1: Dynamixel1.bauds,
    SimulatedFamily.DYNAMIXEL_320: BAUDS_320,
    SimulatedFamily.FEETECH_STS: StsSeries.bauds,
    SimulatedFamily.FEETECH_SCS: ScsSeries.bauds,
}


def table_for(model: str) -> ServoTable:
    """Return the table of a model; case does not matter.

    Raises:
        UnknownModelError: There is no table for the model.
    """
    for name, table in TABLES.items():
        if name.lower() == model.lower():
            return table
    raise UnknownModelError(model, tuple(TABLES))


def make_servo(
    model: str,
    motor: Motor,
    shaft: HornMounting,
    delivered: Mapping[str, int] | None = None,
    seed: int = 0,
) -> Servo:
    """Make a servo of a model, powered up, with factory settings.

    Raises:
        UnknownModelError: There is no table for the model.
    """
    table = table_for(model)
    return _FIRMWARE[table.family](table, motor, shaft, delivered, seed)


def baud_code(family: SimulatedFamily, baud: int) -> int:
    """Compute the value of the baud register for a rate.

    Raises:
        SimulatorError: The family has no such rate.
    """
    bauds = _BAUDS[family]
    for code, rate in bauds.items():
        if abs(rate - baud) <= 0.01 * baud:
            return code
    known = ", ".join(str(rate) for rate in sorted(bauds.values()))
    raise SimulatorError(f"family {family.value} does not support {baud} baud; known: {known}")
