"""The families' firmware: what each does with its registers."""

from __future__ import annotations

from collections.abc import Mapping

from servosim.errors import SimulatorError
from servosim.motor import Motor
from servosim.servo import Servo
from servosim.servos.dynamixel_1 import Dynamixel1
from servosim.servos.dynamixel_x import DynamixelX
from servosim.servos.feetech_scs import FeetechScs
from servosim.servos.feetech_sts import FeetechSts
from servosim.shaft import Shaft
from servosim.tables import Family, table_for

__all__ = ["Dynamixel1", "DynamixelX", "FeetechScs", "FeetechSts", "baud_code", "make_servo"]

_FIRMWARE: dict[Family, type[Servo]] = {
    Family.DYNAMIXEL_X: DynamixelX,
    Family.DYNAMIXEL_1: Dynamixel1,
    Family.FEETECH_STS: FeetechSts,
    Family.FEETECH_SCS: FeetechScs,
}


def make_servo(
    model: str,
    motor: Motor,
    shaft: Shaft,
    delivered: Mapping[str, int] | None = None,
    seed: int = 0,
) -> Servo:
    """Return a servo of a model, powered up, as it was delivered.

    Raises:
        UnknownModelError: No table for such a model.
    """
    table = table_for(model)
    return _FIRMWARE[table.family](table, motor, shaft, delivered, seed)


def baud_code(family: Family, baud: int) -> int:
    """Return the baud register's number for a rate.

    Raises:
        SimulatorError: The family has no such rate.
    """
    bauds = _FIRMWARE[family].bauds
    for code, rate in bauds.items():
        if abs(rate - baud) <= 0.01 * baud:
            return code
    known = ", ".join(str(rate) for rate in sorted(bauds.values()))
    raise SimulatorError(f"servos of family {family.value} have no {baud} baud; known: {known}")
