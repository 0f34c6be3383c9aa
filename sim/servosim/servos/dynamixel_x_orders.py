"""From the memory of a Dynamixel X to its drive: units of goals, profiles, gains and limits."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from servosim.servos.dynamixel_x import DynamixelX

__all__ = ["PWM_FULL", "VELOCITY_RAD_S", "Orders"]

VELOCITY_RAD_S = 0.229 * 2.0 * math.pi / 60.0
ACCELERATION_RAD_S2 = 214.577 * 2.0 * math.pi / 3600.0
PWM_FULL = 885  # 0.113 % each
TICKS_PER_RAD = 4096 / (2.0 * math.pi)
CONTROL_HZ = 1000.0  # assumed rate of the position loop that the I and D gains refer to


class Orders:
    """Hands one servo's registers over to its drive, in SI.

    Attributes:
        servo: Whose.
        senses_current: Whether the model has a current sensor.
        current_unit_a: One step of its current registers.
    """

    def __init__(self, servo: DynamixelX) -> None:
        self.servo = servo
        self.senses_current = "goal_current" in servo.table.by_name
        self.current_unit_a = 0.001 if servo.table.model.startswith("XL330") else 0.00269
        self._profile = (0.0, 0.0, 0.0, 0.0)  # times, then limits, as the drive has them

    def set_position_goal(self) -> None:
        """A goal position was written: hand it over with the profile that belongs to it."""
        drive = self.servo.drive
        (
            drive.profile_time_s, drive.acceleration_time_s,
            drive.velocity_limit_rad_s, drive.acceleration_rad_s2,
        ) = self._profile  # fmt: skip
        drive.goal_rad = self.servo.angle_at(self.servo.memory.get("goal_position"))

    def set_goal(self) -> None:
        """Any goal was written, or what goals mean has changed: hand all of them over."""
        self.set_position_goal()
        drive, get, sign = self.servo.drive, self.servo.memory.get, self.servo.direction
        drive.goal_velocity_rad_s = sign * get("goal_velocity") * VELOCITY_RAD_S
        goal_pwm = get("goal_pwm") / PWM_FULL
        drive.goal_pwm = sign * goal_pwm
        limit = get("pwm_limit") / PWM_FULL
        drive.pwm_limit = limit if self.servo.mode == 16 else min(limit, abs(goal_pwm))
        if self.senses_current:
            drive.goal_current_a = sign * get("goal_current") * self.current_unit_a

    def note_profile(self) -> None:
        """Profile registers written: velocities or times (drive mode bit 2), for the next goal."""
        get = self.servo.memory.get
        velocity, acceleration = get("profile_velocity"), get("profile_acceleration")
        if get("drive_mode") & 4:
            self._profile = (velocity / 1000, min(acceleration, velocity / 2) / 1000, 0.0, 0.0)
            return
        limit = min(velocity, get("velocity_limit")) or velocity
        self._profile = (0.0, 0.0, limit * VELOCITY_RAD_S, acceleration * ACCELERATION_RAD_S2)

    def set_gains(self) -> None:
        """Hand the gains over in SI: the sheets' outputs are PWM steps, their errors ticks."""
        drive, get = self.servo.drive, self.servo.memory.get
        drive.kp = get("position_p_gain") / 128 * TICKS_PER_RAD / PWM_FULL
        drive.ki = get("position_i_gain") / 65536 * TICKS_PER_RAD * CONTROL_HZ / PWM_FULL
        drive.kd = get("position_d_gain") / 16 * TICKS_PER_RAD / CONTROL_HZ / PWM_FULL
        drive.velocity_kp = get("velocity_p_gain") / 128 / VELOCITY_RAD_S / PWM_FULL
        drive.velocity_ki = get("velocity_i_gain") / 65536 * CONTROL_HZ / VELOCITY_RAD_S / PWM_FULL

    def set_limits(self) -> None:
        """Hand the limits of the EEPROM over."""
        drive, get = self.servo.drive, self.servo.memory.get
        drive.moving_threshold_rad_s = get("moving_threshold") * VELOCITY_RAD_S
        if self.senses_current:
            drive.current_limit_a = get("current_limit") * self.current_unit_a
