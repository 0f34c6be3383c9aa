"""What Feetech firmware watches: it limits its output where a Dynamixel would drop its torque."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from servosim.servos.feetech import Feetech

__all__ = ["FeetechWatch"]

VOLTAGE, ENCODER, HEAT, CURRENT, OVERLOAD = 0x01, 0x02, 0x04, 0x08, 0x20
CURRENT_UNIT_A = 0.0065
STILL_RAD_S = 0.1  # assumed: a shaft that moves faster than this is not blocked


class FeetechWatch:
    """Protections of one servo; a bit goes away with its cause, an overload with a new torque."""

    def __init__(self, servo: Feetech) -> None:
        self.servo = servo
        self._has_current = "protection_current" in servo.table.by_name
        self.start()

    def start(self) -> None:
        """Begin anew after power-up."""
        self.bits = 0
        self.injected = 0
        self._overload_s = 0.0
        self._over_current_s = 0.0

    def inject(self, bits: int) -> None:
        """Raise alarm bits without a cause, or take back those that were raised so."""
        self.bits = self.bits & ~self.injected | bits
        self.injected = bits

    def release(self) -> None:
        """Torque or goal written: an overload gets another chance."""
        self.bits &= ~(OVERLOAD | CURRENT)
        self._overload_s = self._over_current_s = 0.0
        self.servo.drive.torque_limit = self.torque_limit()

    def torque_limit(self) -> float:
        """Return the limit in force, 0..1: protective torque after an overload."""
        get = self.servo.memory.get
        name = "torque_limit" if self._has_current else "max_torque"
        limit = min(1.0, get(name) / 1000)
        return min(limit, get("protective_torque") / 100) if self.bits & OVERLOAD else limit

    def look(self, dt_s: float) -> None:
        """Check everything once; ``dt_s`` is the time since the last look."""
        get, servo, motor = self.servo.memory.get, self.servo, self.servo.motor
        volts = round(servo.supply_v * 10)
        self._set(VOLTAGE, not get("min_voltage_limit") <= volts <= get("max_voltage_limit"))
        self._set(HEAT, motor.temperature_c > get("max_temperature_limit"))
        self._look_at_load(dt_s)
        if self._has_current:
            self._look_at_current(dt_s)
        self._unload()

    def _set(self, bit: int, present: bool) -> None:
        self.bits = self.bits | bit if present else self.bits & ~bit
        self.bits |= self.injected

    def _look_at_load(self, dt_s: float) -> None:
        get, motor = self.servo.memory.get, self.servo.motor
        heavy = abs(motor.pwm) * 100 > get("overload_torque")
        blocked = abs(motor.velocity_rad_s) < STILL_RAD_S
        self._overload_s = self._overload_s + dt_s if heavy and blocked else 0.0
        if self._overload_s > get("protection_time") * 0.010 and not self.bits & OVERLOAD:
            self.bits |= OVERLOAD
            self.servo.drive.torque_limit = self.torque_limit()
            self.servo.changed()

    def _look_at_current(self, dt_s: float) -> None:
        get = self.servo.memory.get
        limit_a = get("protection_current") * CURRENT_UNIT_A
        high = abs(self.servo.motor.current_a) > limit_a > 0
        self._over_current_s = self._over_current_s + dt_s if high else 0.0
        if self._over_current_s > get("over_current_time") * 0.010:
            self.bits |= CURRENT

    def _unload(self) -> None:
        """Switch the output off for alarms that the unload condition names."""
        off = self.bits & self.servo.memory.get("unload_condition") & ~OVERLOAD
        if off and self.servo.drive.torque_on:
            self.servo.memory.put("torque_enable", 0)
            self.servo.lose_torque()
