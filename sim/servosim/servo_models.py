"""The firmware class of each servo family."""

from __future__ import annotations

from collections.abc import Mapping

from servosim.dynamixel_1 import Dynamixel1
from servosim.dynamixel_x import SimulatedDynamixelX
from servosim.errors import SimulatorError
from servosim.feetech_models import FeetechScs, FeetechSts
from servosim.motor import Motor
from servosim.register import SimulatedFamily
from servosim.servo import HornMounting, Servo
from servosim.tables import table_for

__all__ = [
    "Dynamixel1",
    "FeetechScs",
    "FeetechSts",
    "SimulatedDynamixelX",
    "baud_code",
    "make_servo",
]

_FIRMWARE: dict[SimulatedFamily, type[Servo]] = {
    SimulatedFamily.DYNAMIXEL_X: SimulatedDynamixelX,
    SimulatedFamily.DYNAMIXEL_1: Dynamixel1,
    SimulatedFamily.FEETECH_STS: FeetechSts,
    SimulatedFamily.FEETECH_SCS: FeetechScs,
}


def make_servo(
    model: str,
    motor: Motor,
    shaft: HornMounting,
    delivered: Mapping[str, int] | None = None,
    seed: int = 0,
) -> Servo:
    """Return a servo of a model, powered up, as it was delivered.

    Raises:
        UnknownModelError: No table for such a model.
    """
    table = table_for(model)
    return _FIRMWARE[table.family](table, motor, shaft, delivered, seed)


def baud_code(family: SimulatedFamily, baud: int) -> int:
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
