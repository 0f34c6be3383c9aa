"""What Feetech firmware watches: it limits its output where a Dynamixel would drop its torque."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from servosim.servos.feetech_sts import FeetechSts

__all__ = ["Watch"]

VOLTAGE, ENCODER, HEAT, CURRENT, OVERLOAD = 0x01, 0x02, 0x04, 0x08, 0x20
CURRENT_UNIT_A = 0.0065
STILL_RAD_S = 0.1  # assumed: a shaft that moves faster than this is not blocked


class Watch:
    """Protections of one servo; a bit goes away with its cause, an overload with a new torque."""

    def __init__(self, servo: FeetechSts) -> None:
        self.servo = servo
        self.start()

    def start(self) -> None:
        """Begin anew after power-up."""
        self.bits = 0
        self.injected = 0
        self._overload_s = 0.0
        self._over_current_s = 0.0

    def release(self) -> None:
        """Torque or goal written: an overload gets another chance."""
        self.bits &= ~(OVERLOAD | CURRENT)
        self._overload_s = self._over_current_s = 0.0
        self.servo.drive.torque_limit = self.torque_limit()

    def torque_limit(self) -> float:
        """Return the limit in force, 0..1: protective torque after an overload."""
        get = self.servo.memory.get
        limit = get("torque_limit") / 1000
        return min(limit, get("protective_torque") / 100) if self.bits & OVERLOAD else limit

    def look(self, dt_s: float) -> None:
        """Check everything once; ``dt_s`` is the time since the last look."""
        get, servo, motor = self.servo.memory.get, self.servo, self.servo.motor
        volts = round(servo.supply_v * 10)
        self._set(VOLTAGE, not get("min_voltage_limit") <= volts <= get("max_voltage_limit"))
        self._set(HEAT, motor.temperature_c > get("max_temperature_limit"))
        self._look_at_load(dt_s)
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
        if self._overload_s > get("protection_time") * 0.010:
            self.bits |= OVERLOAD
            self.servo.drive.torque_limit = self.torque_limit()

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
        if off:
            self.servo.memory.put("torque_enable", 0)
            self.servo.drive.torque_on = False
