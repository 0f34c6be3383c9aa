"""What Dynamixel X firmware watches: heat, load, voltage, bus watchdog, arrival."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from servosim.servos.dynamixel_x import DynamixelX

__all__ = ["Watch"]

VOLTAGE, HEAT, ENCODER, SHOCK, OVERLOAD = 0x01, 0x04, 0x08, 0x10, 0x20
OVERLOAD_AFTER_S = 2.0  # assumed: the sheets say "persistent"
OVERLOAD_SHARE = 0.9  # assumed share of the largest output that counts as overload
IN_POSITION_TICK = 8  # assumed
FOLLOWING_TICK = 200  # assumed


class Watch:
    """Protections and status bits of one servo."""

    def __init__(self, servo: DynamixelX) -> None:
        self.servo = servo
        self.shut_down = False
        self._overload_s = 0.0
        self._injected = 0

    def start(self) -> None:
        """Begin anew after power-up; only this clears a shutdown."""
        self.shut_down = False
        self._overload_s = 0.0
        self._injected = 0

    def raise_alarm(self, bits: int) -> None:
        """Set hardware error bits; those in the shutdown register drop the torque."""
        servo = self.servo
        servo.memory.put("hardware_error_status", servo.memory.get("hardware_error_status") | bits)
        if bits & servo.memory.get("shutdown"):
            self.shut_down = True
            servo.memory.put("torque_enable", 0)
            servo.lose_torque()

    def look(self, dt_s: float) -> None:
        """Check everything once; ``dt_s`` is the time since the last look."""
        get, servo = self.servo.memory.get, self.servo
        if servo.motor.temperature_c > get("temperature_limit"):
            self.raise_alarm(HEAT)
        if not get("min_voltage_limit") <= round(servo.supply_v * 10) <= get("max_voltage_limit"):
            self.raise_alarm(VOLTAGE)
        self._look_at_load(dt_s)
        self._look_at_bus()

    def start_watchdog(self) -> None:
        """Bus watchdog written: the interval counts from now."""
        self.servo.heard_s = self.servo.time_s

    def moving_status(self) -> int:
        """Return the moving status register: arrival, running profile and its kind, lag."""
        servo, motor = self.servo, self.servo.motor
        if servo.mode not in (3, 4, 5):
            return 0
        unit = servo.shaft.rad_per_tick
        arrived = abs(servo.drive.goal_rad - motor.encoder_rad) <= IN_POSITION_TICK * unit
        lagging = abs(motor.reference_rad - motor.encoder_rad) > FOLLOWING_TICK * unit
        return arrived | motor.profile_running << 1 | lagging << 3 | self._profile_kind()

    def _profile_kind(self) -> int:
        drive = self.servo.drive
        if drive.velocity_limit_rad_s == 0 and drive.profile_time_s == 0:
            return 0x00
        ramps = drive.acceleration_rad_s2 > 0 or drive.acceleration_time_s > 0
        return 0x30 if ramps else 0x10

    def _look_at_load(self, dt_s: float) -> None:
        servo, motor = self.servo, self.servo.motor
        heavy = abs(motor.torque_nm) > OVERLOAD_SHARE * motor.parameters.stall_torque_nm
        self._overload_s = self._overload_s + dt_s if heavy and servo.drive.torque_on else 0.0
        if self._overload_s > OVERLOAD_AFTER_S:
            self.raise_alarm(OVERLOAD)

    def _look_at_bus(self) -> None:
        servo = self.servo
        steps = servo.memory.get("bus_watchdog")
        late = servo.time_s - servo.heard_s > steps * 0.020
        if steps > 0 and servo.drive.torque_on and late:
            servo.memory.put("bus_watchdog", -1)
            servo.hold_here()
