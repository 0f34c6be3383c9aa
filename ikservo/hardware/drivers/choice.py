"""Which driver speaks which family's dialect."""

from __future__ import annotations

from collections.abc import Collection

from ikservo.hardware.drivers.driver import Driver
from ikservo.hardware.line.port import Port
from ikservo.registers import Family

__all__ = ["driver_for"]


def driver_for(
    family: Family, port: Port, *, fast: bool = True, bulk_ids: Collection[int] = ()
) -> Driver:
    """Return a driver for a family of servos; its vendor's SDK is imported only now.

    Args:
        family: The dialect.
        port: The line.
        fast: Whether the family's fastest way to ask many servos is tried first.
        bulk_ids: Servos of protocol 1.0 that know bulk read.
    """
    if family is Family.DYNAMIXEL_2:
        from ikservo.hardware.drivers.dynamixel import DynamixelDriver  # noqa: PLC0415

        return DynamixelDriver(port, fast=fast)
    if family is Family.DYNAMIXEL_1:
        from ikservo.hardware.drivers.dynamixel_1 import Dynamixel1Driver  # noqa: PLC0415

        return Dynamixel1Driver(port, bulk_ids)
    from ikservo.hardware.drivers.feetech import FeetechDriver  # noqa: PLC0415

    return FeetechDriver(port, can_sync_read=family is Family.FEETECH_STS)
