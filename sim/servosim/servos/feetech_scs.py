"""Firmware of the Feetech SCS series: a potentiometer, 10 bits, big-endian (SCSCL memory table)."""

from __future__ import annotations

from types import MappingProxyType

from servosim.drive import Mode
from servosim.servos.feetech import BAUDS, Feetech

__all__ = ["FeetechScs"]


class FeetechScs(Feetech):
    """An SCS servo."""

    bauds = MappingProxyType(dict(enumerate(BAUDS[:8])))
    instructions = frozenset((1, 2, 3, 4, 5, 6, 0x83))

    def asked_mode(self) -> Mode:
        """Return motor mode when both position limits are zero, else position mode."""
        lower, upper = self.memory.get("min_position_limit"), self.memory.get("max_position_limit")
        return Mode.PWM if lower == upper == 0 else Mode.POSITION

    def set_goal(self) -> None:
        """A goal register was written: the time counts only without a speed."""
        drive, get, sign = self.drive, self.memory.get, self.shaft.sign
        speed_rad_s = get("goal_speed") * self.shaft.rad_per_tick
        time_s = get("goal_time") / 1000
        timed = speed_rad_s == 0.0 and time_s > 0.0
        drive.mode = self.asked_mode()
        drive.profile_time_s = time_s if timed and drive.mode is Mode.POSITION else 0.0
        drive.velocity_limit_rad_s = 0.0 if timed else self.profile_speed(abs(speed_rad_s))
        drive.goal_pwm = sign * time_s
        drive.goal_rad = self.angle_at(self.clamped_goal())

    def list_live(self) -> None:
        """Fill ``live``."""
        super().list_live()
        motor, shaft = self.motor, self.shaft
        self.live |= {
            "present_speed": lambda: round(shaft.sign * motor.velocity_rad_s / shaft.rad_per_tick),
        }
