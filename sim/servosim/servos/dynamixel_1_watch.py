"""What AX and MX firmware watches: a shutdown sets the torque limit to zero."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from servosim.servos.dynamixel_1 import Dynamixel1

__all__ = ["ANGLE", "HEAT", "OVERLOAD", "VOLTAGE", "Dynamixel1Watch"]

VOLTAGE, ANGLE, HEAT, OVERLOAD = 0x01, 0x02, 0x04, 0x20
OVERLOAD_AFTER_S = 2.0  # assumed: the sheets say "persistent"
OVERLOAD_SHARE = 0.9  # assumed share of the largest output that counts as overload


class Dynamixel1Watch:
    """Protections of one servo."""

    def __init__(self, servo: Dynamixel1) -> None:
        self.servo = servo
        self.start()

    def start(self) -> None:
        """Begin anew after power-up."""
        self.bits = 0
        self.injected = 0
        self._overload_s = 0.0

    def inject(self, bits: int) -> None:
        """Raise alarm bits without a cause, or take back those that were raised so."""
        self.bits = self.bits & ~self.injected | bits
        self.injected = bits

    def release(self) -> None:
        """Torque limit written: an overload gets another chance."""
        self.bits &= ~OVERLOAD
        self._overload_s = 0.0

    def look(self, dt_s: float) -> None:
        """Check everything once; ``dt_s`` is the time since the last look."""
        get, servo, motor = self.servo.memory.get, self.servo, self.servo.motor
        volts = round(servo.supply_v * 10)
        self._set(VOLTAGE, not get("min_voltage_limit") <= volts <= get("max_voltage_limit"))
        self._set(HEAT, motor.temperature_c > get("temperature_limit"))
        heavy = abs(motor.torque_nm) > OVERLOAD_SHARE * motor.parameters.stall_torque_nm
        self._overload_s = self._overload_s + dt_s if heavy and servo.drive.torque_on else 0.0
        if self._overload_s > OVERLOAD_AFTER_S:
            self.bits |= OVERLOAD
        if self.bits & get("shutdown") and servo.drive.torque_limit > 0.0:
            servo.memory.put("torque_limit", 0)
            servo.drive.torque_limit = 0.0
            servo.changed()

    def _set(self, bit: int, present: bool) -> None:
        self.bits = self.bits | bit if present else self.bits & ~bit
        self.bits |= self.injected
