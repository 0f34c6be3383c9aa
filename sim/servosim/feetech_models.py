"""The STS, HLS and SCS series of Feetech servos (memory tables)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from servosim.control import ControlMode
from servosim.feetech import BAUDS, Feetech, FeetechSeries
from servosim.servo import HornMounting

CURRENT_UNIT_A = 0.0065
_FROM_EEPROM = {  # registers that an HLS copies into its RAM at power-up
    "goal_torque": "protection_current", "kp": "p_gain", "kd": "d_gain", "ki": "i_gain",
    "goal_speed": "max_speed_limit",
}  # fmt: skip
CALIBRATE = 128  # value of torque_enable that makes the present position tick 2048
SPEED_LIMIT_STEPS = 50  # steps/s per unit of register 84, whatever the phase says
STEP = 3  # operating mode in which goals are added up
PHASE_FINE_SPEED, PHASE_TURNS = 0x04, 0x10


_STS_MODES = (ControlMode.POSITION, ControlMode.VELOCITY, ControlMode.PWM, ControlMode.POSITION)
_HLS_MODES = (
    ControlMode.POSITION, ControlMode.VELOCITY, ControlMode.CURRENT, ControlMode.PWM,
    ControlMode.POSITION,
)  # fmt: skip


class StsSeries(FeetechSeries):
    """An STS or HLS servo; an HLS has a goal torque, and speeds only in units of 50 steps/s."""

    bauds = MappingProxyType(dict(enumerate(BAUDS)))
    instructions = frozenset((1, 2, 3, 4, 5, 6, 8, 9, 0x0A, 0x0B, 0x82, 0x83))
    answers_broadcast_ping = True
    goal_enables_torque = True  # reported from hardware (lerobot issue 3585)

    def __init__(self, servo: Feetech) -> None:
        super().__init__(servo)
        self.memory, self.shaft, self.motor, self.drive = (
            servo.memory, servo.shaft, servo.motor, servo.drive,
        )  # fmt: skip
        self.is_hls = "goal_torque" in servo.table.by_name
        self.turn_base_tick = 0
        self.step_goal_tick = 0
        self.speed_unit_rad_s = servo.shaft.rad_per_tick

    @staticmethod
    def sensor_mounting(shaft: HornMounting, delivered: Mapping[str, int]) -> HornMounting:
        """Return the mounting of the sensor on the horn, before the homing offset is applied."""
        offset = delivered.get("homing_offset", 0)
        return HornMounting(shaft.sign, shaft.zero_tick + offset, shaft.ticks)

    # Position.

    def actual_tick(self) -> int:
        """Compute the sensor's tick, multi-turn since power-up."""
        return self.shaft.tick_at(self.motor.encoder_rad) - self.turn_base_tick

    def present_tick(self) -> int:
        """Return the present position: single turn unless phase bit 4 is set."""
        return self._reported_tick(self.actual_tick())

    def _reported_tick(self, actual_tick: int) -> int:
        tick = actual_tick - self.memory.get("homing_offset")
        return tick if self.memory.get("phase") & PHASE_TURNS else tick % 4096

    def angle_at(self, position_tick: int) -> float:
        """Compute the joint angle [rad] that a value of the position register means now.

        The firmware compares goal and present within one revolution, so no motion crosses the
        wrap-around.
        """
        actual = self.actual_tick()
        return self.shaft.angle_at(
            actual + position_tick - self._reported_tick(actual) + self.turn_base_tick
        )

    def calibrate(self, position_tick: int = 2048) -> None:
        """Make the present position the given tick by choosing the homing offset."""
        offset = (self.actual_tick() - position_tick + 2048) % 4096 - 2048
        self.memory.put("homing_offset", max(-2047, offset))
        self.memory.persist_value("homing_offset")
        self.servo.hold_position()

    def reset_turns(self) -> None:
        """Reduce the position to a single revolution."""
        self.turn_base_tick = self.shaft.tick_at(self.motor.encoder_rad) // 4096 * 4096
        self.set_goal()

    # From memory to drive.

    def start(self) -> None:
        """Set revolutions, torque limit and units from the memory after power-up."""
        self.turn_base_tick = self.shaft.tick_at(self.motor.encoder_rad) // 4096 * 4096
        self.memory.put("torque_limit", self.memory.get("max_torque"))
        if self.is_hls:
            for name, stored in _FROM_EEPROM.items():
                self.memory.put(name, self.memory.get(stored))
        self.set_phase()

    def refresh_goal(self) -> None:
        """Apply the goal again: beyond the wrap-around the same number is another position."""
        if self.drive.torque_on and self.memory.get("operating_mode") == 0:
            self.drive.goal_rad = self.angle_at(self.servo.clamped_goal())

    def requested_mode(self) -> ControlMode:
        """Return the mode of the operating mode register; step mode starts at the present tick."""
        self.step_goal_tick = self.actual_tick()
        return (_HLS_MODES if self.is_hls else _STS_MODES)[self.memory.get("operating_mode")]

    def set_torque(self) -> None:
        """Apply a write to torque enable: 128 calibrates and leaves the torque unchanged."""
        if self.memory.get("torque_enable") == CALIBRATE:
            self.memory.put("torque_enable", int(self.drive.torque_on))
            self.calibrate()
        else:
            self.servo.set_torque()

    def set_phase(self) -> None:
        """Apply a write to phase: bit 2 is the unit of speeds, 1 or 50 steps/s."""
        fine = not self.is_hls and self.memory.get("phase") & PHASE_FINE_SPEED
        steps = 1 if fine else 50
        self.speed_unit_rad_s = steps * self.shaft.rad_per_tick
        threshold = self.memory.get("moving_threshold")
        self.drive.moving_threshold_rad_s = threshold * self.speed_unit_rad_s

    def set_goal(self) -> None:
        """Apply goal, speed and acceleration together after a write to a goal register."""
        drive, get, sign = self.drive, self.memory.get, self.shaft.sign
        greatest_rad_s = get("max_speed_limit") * SPEED_LIMIT_STEPS * self.shaft.rad_per_tick
        speed_rad_s = get("goal_speed") * self.speed_unit_rad_s
        speed_rad_s = max(-greatest_rad_s, min(greatest_rad_s, speed_rad_s))
        drive.acceleration_rad_s2 = get("acceleration") * 100 * self.shaft.rad_per_tick
        drive.velocity_limit_rad_s = self.servo.profile_speed(abs(speed_rad_s)) or greatest_rad_s
        drive.goal_velocity_rad_s = sign * speed_rad_s
        if self.is_hls:
            self._set_current(get("goal_torque"))
        else:
            drive.goal_pwm = sign * get("goal_time") / 1000
        if get("operating_mode") == STEP and not self.is_hls:
            drive.goal_rad = self.shaft.angle_at(self.step_goal_tick + self.turn_base_tick)
        else:
            drive.goal_rad = self.angle_at(self.servo.clamped_goal())

    def _set_current(self, goal_torque: int) -> None:
        """Apply the goal torque: the goal in current mode, a limit otherwise; 0 means no torque."""
        drive, current_a = self.drive, goal_torque * CURRENT_UNIT_A
        drive.goal_current_a = self.shaft.sign * current_a
        drive.current_limit_a = abs(current_a)
        drive.goal_pwm = self.shaft.sign * goal_torque / 1000

    def set_position_goal(self) -> None:
        """Apply a write to the goal position; in step mode it is added to the previous goal."""
        get, servo = self.memory.get, self.servo
        mode = get("operating_mode")
        if mode == STEP and not self.is_hls:
            self.step_goal_tick += get("goal_position")
            self.set_goal()
        elif mode != 0 or get("torque_enable") != 0:
            self.drive.goal_rad = self.angle_at(servo.clamped_goal())
        elif servo.goal_enables_torque and not servo.watch.is_unloaded:
            self.memory.put("torque_enable", 1)
            servo.set_torque()
        else:
            self.set_goal()

    def change_phase(self) -> None:
        """Apply a write to phase: speeds in registers get another unit."""
        self.set_phase()
        self.set_goal()

    def nearest_limit(self, goal: int, lower: int, upper: int) -> int:
        """Return the limit that is nearest on the circle of one turn."""
        return min(lower, upper, key=lambda limit: abs((goal - limit + 2048) % 4096 - 2048))

    def apply_gains(self) -> None:
        """Apply the limit of the integral."""
        self.drive.integral_limit = self.memory.get("integral_limit") * 4 / 1000 or 1.0

    # Tables of measured registers and of write effects.

    def live_registers(self) -> dict[str, Callable[[], int]]:
        """Return the getter of each measured register of the series."""
        motor, sign = self.motor, self.shaft.sign
        return {
            "present_speed": lambda: round(sign * motor.velocity_rad_s / self.speed_unit_rad_s),
            "present_current": lambda: round(
                (sign * motor.current_a if self.is_hls else abs(motor.current_a)) / CURRENT_UNIT_A
            ),
            "target_position": lambda: self.memory.get("goal_position"),
        }

    def write_effects(self) -> dict[str, Callable[[], None]]:
        """Return functions to call after writes; they add to or replace those of the family."""
        servo = self.servo
        return {
            "torque_enable": self.set_torque,
            "operating_mode": servo.set_mode,
            "goal_position": self.set_position_goal,
            "torque_limit": servo.set_limits,
            "integral_limit": servo.set_gains,
            "moving_threshold": self.set_phase,
            "phase": self.change_phase,
            "acceleration": servo.set_goal,
            "max_speed_limit": servo.set_goal,
            "homing_offset": servo.set_goal,
        }


class ScsSeries(FeetechSeries):
    """An SCS servo."""

    bauds = MappingProxyType(dict(enumerate(BAUDS[:8])))
    instructions = frozenset((1, 2, 3, 4, 5, 6, 0x83))

    def requested_mode(self) -> ControlMode:
        """Return motor mode if both position limits are zero, otherwise position mode."""
        get = self.servo.memory.get
        lower, upper = get("min_position_limit"), get("max_position_limit")
        return ControlMode.PWM if lower == upper == 0 else ControlMode.POSITION

    def set_goal(self) -> None:
        """Apply a write to a goal register; the goal time is used only if no goal speed is set."""
        servo, drive, shaft = self.servo, self.servo.drive, self.servo.shaft
        speed_rad_s = servo.memory.get("goal_speed") * shaft.rad_per_tick
        duty_or_ms = "goal_time" if "goal_time" in servo.table.by_name else "goal_pwm"
        time_s = servo.memory.get(duty_or_ms) / 1000
        timed = duty_or_ms == "goal_time" and speed_rad_s == 0.0 and time_s > 0.0
        drive.mode = self.requested_mode()
        drive.profile_time_s = time_s if timed and drive.mode is ControlMode.POSITION else 0.0
        drive.velocity_limit_rad_s = 0.0 if timed else servo.profile_speed(abs(speed_rad_s))
        drive.goal_pwm = shaft.sign * time_s
        drive.goal_rad = self.angle_at(servo.clamped_goal())

    def live_registers(self) -> dict[str, Callable[[], int]]:
        """Return the getter of each measured register of the series."""
        motor, shaft = self.servo.motor, self.servo.shaft
        return {
            "present_speed": lambda: round(shaft.sign * motor.velocity_rad_s / shaft.rad_per_tick),
            "present_current": lambda: round(shaft.sign * motor.current_a / CURRENT_UNIT_A),
        }
