"""Servo control: profile generator, drive commands in SI units, position controller."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple


class ProfileSegment(NamedTuple):
    """A time interval with constant acceleration."""

    duration_s: float
    velocity_rad_s: float  # at its start
    acceleration_rad_s2: float


def trapezoid(
    distance_rad: float, velocity_rad_s: float, limit_rad_s: float, acceleration_rad_s2: float
) -> list[ProfileSegment]:
    """Plan from the present velocity to rest at a distance, as fast as the limits allow.

    The velocity is continuous when the goal changes: a goal that is too near to stop at is overrun,
    and the motion reverses. Both sides of the trapezoid have the same slope (Dynamixel e-manual,
    "Profile Velocity", Feetech "acceleration" and "goal speed").

    Args:
        distance_rad: Signed distance to the goal.
        velocity_rad_s: Present velocity.
        limit_rad_s: Cruising speed; 0 = unlimited.
        acceleration_rad_s2: Slope of both ramps; 0 = no ramps, the velocity jumps.

    Returns:
        The segments; none if the reference jumps to the goal.
    """
    if acceleration_rad_s2 <= 0.0:
        return _rectangle_profile(distance_rad, limit_rad_s)
    stop_rad = velocity_rad_s * abs(velocity_rad_s) / (2.0 * acceleration_rad_s2)
    sign = math.copysign(1.0, distance_rad - stop_rad)
    forward_rad, speed_rad_s = sign * distance_rad, sign * velocity_rad_s
    peak_rad_s = math.sqrt(max(0.0, acceleration_rad_s2 * forward_rad + speed_rad_s**2 / 2.0))
    top_rad_s = min(peak_rad_s, limit_rad_s) if limit_rad_s > 0.0 else peak_rad_s
    ramp_s = abs(top_rad_s - speed_rad_s) / acceleration_rad_s2
    brake_s = top_rad_s / acceleration_rad_s2
    ramps_rad = (speed_rad_s + top_rad_s) / 2.0 * ramp_s + top_rad_s / 2.0 * brake_s
    cruise_s = max(0.0, forward_rad - ramps_rad) / top_rad_s if top_rad_s > 0.0 else 0.0
    slope = math.copysign(acceleration_rad_s2, top_rad_s - speed_rad_s)
    return [
        ProfileSegment(ramp_s, velocity_rad_s, sign * slope),
        ProfileSegment(cruise_s, sign * top_rad_s, 0.0),
        ProfileSegment(brake_s, sign * top_rad_s, -sign * acceleration_rad_s2),
    ]


def timed(
    distance_rad: float, velocity_rad_s: float, total_s: float, ramp_s: float
) -> list[ProfileSegment]:
    """Plan from the present velocity to rest at a distance, in a given time.

    Dynamixel's time-based profile (drive mode bit 2): Profile Velocity is the whole time,
    Profile Acceleration each ramp, cut to half of the whole. Feetech's goal time has no ramps.
    """
    ramp_s = min(ramp_s, total_s / 2.0)
    if ramp_s <= 0.0:
        return [ProfileSegment(total_s, distance_rad / total_s, 0.0)]
    cruise_rad_s = (distance_rad - velocity_rad_s * ramp_s / 2.0) / (total_s - ramp_s)
    return [
        ProfileSegment(ramp_s, velocity_rad_s, (cruise_rad_s - velocity_rad_s) / ramp_s),
        ProfileSegment(total_s - 2.0 * ramp_s, cruise_rad_s, 0.0),
        ProfileSegment(ramp_s, cruise_rad_s, -cruise_rad_s / ramp_s),
    ]


def ramp(
    velocity_rad_s: float, goal_rad_s: float, acceleration_rad_s2: float
) -> list[ProfileSegment]:
    """Plan a ramp from one velocity to another; no segments if the velocity jumps."""
    if acceleration_rad_s2 <= 0.0 or goal_rad_s == velocity_rad_s:
        return []
    slope = math.copysign(acceleration_rad_s2, goal_rad_s - velocity_rad_s)
    return [ProfileSegment((goal_rad_s - velocity_rad_s) / slope, velocity_rad_s, slope)]


def _rectangle_profile(distance_rad: float, limit_rad_s: float) -> list[ProfileSegment]:
    if limit_rad_s <= 0.0 or distance_rad == 0.0:
        return []
    return [
        ProfileSegment(
            abs(distance_rad) / limit_rad_s, math.copysign(limit_rad_s, distance_rad), 0.0
        )
    ]


class ProfileGenerator:
    """A reference that moves along a profile; exact at any step length."""

    __slots__ = (
        "_elapsed_s", "_end_rad", "_end_rad_s", "_pieces", "_start_rad",
        "acceleration_rad_s2", "position_rad", "running", "velocity_rad_s",
    )  # fmt: skip

    def __init__(self, position_rad: float) -> None:
        self._pieces: list[ProfileSegment] = []
        self._elapsed_s = 0.0
        self._start_rad = self._end_rad = self.position_rad = position_rad
        self._end_rad_s = self.velocity_rad_s = self.acceleration_rad_s2 = 0.0
        self.running = False

    def reset_to(self, position_rad: float, velocity_rad_s: float = 0.0) -> None:
        """Discard the profile and rest at a position."""
        self.position_rad = position_rad
        self.follow((), position_rad, velocity_rad_s)

    def follow(
        self, pieces: Sequence[ProfileSegment], end_rad: float, end_rad_s: float = 0.0
    ) -> None:
        """Move along the segments `pieces`, and end exactly at a position with a velocity."""
        self._pieces = [piece for piece in reversed(pieces) if piece.duration_s > 0.0]
        self._end_rad, self._end_rad_s = end_rad, end_rad_s
        self._start_segment()

    def advance(self, dt_s: float) -> None:
        """Advance by `dt_s` seconds."""
        elapsed_s = self._elapsed_s + dt_s
        while self.running and elapsed_s >= self._pieces[-1].duration_s:
            elapsed_s -= self._finish_segment()
        if not self.running:
            return
        _, velocity_rad_s, acceleration_rad_s2 = self._pieces[-1]
        gained_rad_s = acceleration_rad_s2 * elapsed_s
        self._elapsed_s = elapsed_s
        self.velocity_rad_s = velocity_rad_s + gained_rad_s
        self.position_rad = self._start_rad + (velocity_rad_s + gained_rad_s / 2.0) * elapsed_s

    def _finish_segment(self) -> float:
        duration_s, velocity_rad_s, acceleration_rad_s2 = self._pieces.pop()
        mean_rad_s = velocity_rad_s + acceleration_rad_s2 * duration_s / 2.0
        self.position_rad = self._start_rad + mean_rad_s * duration_s
        self._start_segment()
        return duration_s

    def _start_segment(self) -> None:
        self._elapsed_s = 0.0
        self.running = bool(self._pieces)
        if self.running:
            self._start_rad = self.position_rad
            _, self.velocity_rad_s, self.acceleration_rad_s2 = self._pieces[-1]
        else:
            self.position_rad, self.velocity_rad_s = self._end_rad, self._end_rad_s
            self.acceleration_rad_s2 = 0.0


class ControlMode(Enum):
    """The quantity that the firmware controls."""

    POSITION = "position"
    VELOCITY = "velocity"
    PWM = "pwm"
    CURRENT = "current"
    CURRENT_POSITION = "current-based position"


@dataclass(slots=True)
class DriveCommand:
    """The commands of a servo's memory in SI units; set by the servo, read by the motor.

    The position loop acts on the bridge's duty (PWM, -1..1), as in the datasheets' diagrams:
    `duty = kp e + ki ∫e dt + kd de/dt + startup_pwm sign(e) + kv v + ka a`, with
    `e = reference - encoder` in whole ticks of the sensor, less the dead zone, and v, a of the
    reference. The stiffness at the output is therefore `kp` times the torque at full duty and the
    supply's voltage.

    The motor plans a new profile from the reference's present position and velocity whenever one
    of goal_rad, velocity_limit_rad_s, acceleration_rad_s2, profile_time_s, acceleration_time_s
    changes; a servo that takes new limits only with the next goal writes them together with it.

    Attributes:
        torque_on: False opens the bridge: the shaft can be moved by hand.
        mode: The quantity that the firmware controls.
        goal_rad: Goal of POSITION and CURRENT_POSITION.
        goal_velocity_rad_s: Goal of VELOCITY.
        goal_pwm: Goal of PWM, -1..1.
        goal_current_a: Goal of CURRENT; its magnitude is the limit of CURRENT_POSITION.
        velocity_limit_rad_s: The profile's cruising speed; 0 = unlimited.
        acceleration_rad_s2: The profile's acceleration, also of VELOCITY; 0 = at once.
        profile_time_s: Time-based profile: from start to rest; 0 = use the two limits above.
        acceleration_time_s: Time-based profile: each ramp, at most half of profile_time_s.
        kp: Position gain [1/rad].
        ki: Position gain [1/(rad s)].
        kd: Position gain [s/rad].
        integral_limit: Largest magnitude of the integral's part of the duty, 0..1.
        velocity_kp: Velocity gain [s/rad].
        velocity_ki: Velocity gain [1/rad].
        velocity_feed_forward: Duty per rad/s of the reference [s/rad].
        acceleration_feed_forward: Duty per rad/s² of the reference [s²/rad].
        tick_rad: Resolution of the sensor; 0 = infinite.
        dead_zone_rad: Errors up to this size count as zero; larger errors are reduced by it.
        startup_pwm: Duty added in the direction of an error outside the dead zone (Feetech's
            start-up force).
        minimum_pwm: Smallest duty for an error outside the dead zone (Dynamixel's punch).
        protected_error_rad: Beyond this distance from the goal the duty drops to PROTECTED_SHARE.
        torque_limit: Limit of the duty, 0..1 (Feetech's torque limit).
        pwm_limit: Limit of the duty, 0..1 (Dynamixel's PWM limit); the smaller limit applies.
        current_limit_a: Limit of the winding's current.
        moving_threshold_rad_s: Speed above which `Motor.moving` is true.
    """

    torque_on: bool = False
    mode: ControlMode = ControlMode.POSITION
    goal_rad: float = 0.0
    goal_velocity_rad_s: float = 0.0
    goal_pwm: float = 0.0
    goal_current_a: float = 0.0
    velocity_limit_rad_s: float = 0.0
    acceleration_rad_s2: float = 0.0
    profile_time_s: float = 0.0
    acceleration_time_s: float = 0.0
    kp: float = 5.3
    ki: float = 0.0
    kd: float = 0.0
    integral_limit: float = 1.0
    velocity_kp: float = 0.5
    velocity_ki: float = 5.0
    velocity_feed_forward: float = 0.0
    acceleration_feed_forward: float = 0.0
    tick_rad: float = 0.0
    dead_zone_rad: float = 0.0
    startup_pwm: float = 0.0
    minimum_pwm: float = 0.0
    protected_error_rad: float = math.inf
    torque_limit: float = 1.0
    pwm_limit: float = 1.0
    current_limit_a: float = math.inf
    moving_threshold_rad_s: float = 0.24


PROTECTED_SHARE = 0.25  # scope, no motor connected: 0.041 instead of 0.165 duty/(P rad) from 100°
RELEASED: tuple[object, ...] = (None,)
# A module's names are looked up fast; a member of an Enum takes half a microsecond (Python 3.11).
POSITION, VELOCITY, PWM = ControlMode.POSITION, ControlMode.VELOCITY, ControlMode.PWM
CURRENT, CURRENT_POSITION = ControlMode.CURRENT, ControlMode.CURRENT_POSITION
PROFILED = (POSITION, CURRENT_POSITION)


class Controller:
    """The control loop of every mode, on the position and velocity of the output shaft.

    Attributes:
        reference: The position of the profile.
        derivative: The damping gain: duty per rad/s.
        saturated: Set by the motor when a limit cut the duty; the integral then waits.
    """

    __slots__ = ("_integral", "_order", "derivative", "reference", "saturated")

    def __init__(self, position_rad: float) -> None:
        self.reference = ProfileGenerator(position_rad)
        self._order = RELEASED
        self._integral = self.derivative = 0.0
        self.saturated = False

    def release(self, position_rad: float) -> None:
        """Follow the shaft and reset the state, because the torque is off."""
        if self._order is RELEASED:
            self.reference.position_rad = position_rad
            return
        self.reference.reset_to(position_rad)
        self._order = RELEASED
        self._integral = self.derivative = 0.0
        self.saturated = False

    def duty(
        self,
        dt_s: float,
        drive: DriveCommand,
        position_rad: float,
        velocity_rad_s: float,
    ) -> float:
        """Compute the duty of the gains, without limits; then advance the profile.

        Args:
            dt_s: Time until the next call.
            drive: The commands.
            position_rad: The sensor's position.
            velocity_rad_s: The sensor's velocity.
        """
        mode = drive.mode
        order = (
            mode, drive.goal_rad, drive.goal_velocity_rad_s, drive.velocity_limit_rad_s,
            drive.acceleration_rad_s2, drive.profile_time_s, drive.acceleration_time_s,
        )  # fmt: skip
        if order != self._order:
            self._accept_command(order, drive, position_rad, velocity_rad_s)
        reference = self.reference
        if mode in PROFILED:
            error_rad, acceleration_rad_s2 = reference.position_rad - position_rad, 0.0
            if reference.running:
                acceleration_rad_s2 = reference.acceleration_rad_s2
                reference.advance(dt_s)
            moved_rad = reference.position_rad - position_rad - error_rad
            ahead = moved_rad / dt_s, acceleration_rad_s2
            return self._position_duty(dt_s, drive, error_rad, ahead, position_rad, velocity_rad_s)
        if mode is not VELOCITY:
            return drive.goal_pwm if mode is PWM else math.copysign(1.0, drive.goal_current_a)
        duty = self._velocity_duty(dt_s, drive, velocity_rad_s)
        if reference.running:
            reference.advance(dt_s)
        return duty

    def _position_duty(
        self,
        dt_s: float,
        drive: DriveCommand,
        error_rad: float,
        ahead: tuple[float, float],
        position_rad: float,
        velocity_rad_s: float,
    ) -> float:
        """Compute the duty of the position gains.

        During a profile the D gain acts on the change of the error, so that its contributions add
        up to zero. The profile's velocity is the mean velocity over the step of the loop.

        Args:
            dt_s: The step.
            drive: The commands.
            error_rad: The error at the beginning of the step.
            ahead: Velocity and acceleration of the profile in the step.
            position_rad: The sensor's position.
            velocity_rad_s: The sensor's velocity.
        """
        (reference_rad_s, acceleration_rad_s2), dead_rad = ahead, drive.dead_zone_rad
        if drive.tick_rad:
            error_rad = drive.tick_rad * round(error_rad / drive.tick_rad)
        if -dead_rad <= error_rad <= dead_rad:
            error_rad = 0.0
        elif dead_rad:
            error_rad -= math.copysign(dead_rad, error_rad)
        duty = drive.kp * error_rad
        if drive.ki:
            duty += self._integrate_error(drive.ki * error_rad * dt_s, drive.integral_limit)
        if error_rad:
            duty = self._started_duty(duty, drive, error_rad, drive.goal_rad - position_rad)
        self.derivative = drive.kd
        if drive.kd:
            duty += drive.kd * (reference_rad_s - velocity_rad_s)
        if reference_rad_s:
            duty += drive.velocity_feed_forward * reference_rad_s
            duty += drive.acceleration_feed_forward * acceleration_rad_s2
        return duty

    def _started_duty(
        self, duty: float, drive: DriveCommand, error_rad: float, way_rad: float
    ) -> float:
        """Add the start-up force, and protect the gears while the goal is far away."""
        if drive.startup_pwm:
            duty += math.copysign(drive.startup_pwm, error_rad)
        elif drive.minimum_pwm and abs(duty) < drive.minimum_pwm:
            duty = math.copysign(drive.minimum_pwm, error_rad)
        return duty if abs(way_rad) < drive.protected_error_rad else PROTECTED_SHARE * duty

    def _velocity_duty(self, dt_s: float, drive: DriveCommand, velocity_rad_s: float) -> float:
        error_rad_s = self.reference.velocity_rad_s - velocity_rad_s
        self.derivative = drive.velocity_kp
        gained = self._integrate_error(drive.velocity_ki * error_rad_s * dt_s, drive.integral_limit)
        return drive.velocity_kp * error_rad_s + gained

    def _integrate_error(self, gain: float, limit: float) -> float:
        if not self.saturated or gain * self._integral < 0.0:
            self._integral = min(limit, max(-limit, self._integral + gain))
        return self._integral

    def _accept_command(
        self,
        order: tuple[object, ...],
        drive: DriveCommand,
        position_rad: float,
        velocity_rad_s: float,
    ) -> None:
        """Plan again; after torque on or a new mode, start at the shaft's position."""
        if order[0] is not self._order[0]:
            self.reference.reset_to(position_rad, velocity_rad_s)
            self._integral = self.derivative = 0.0
        self._order = order
        if drive.mode is VELOCITY:
            goal_rad_s = drive.goal_velocity_rad_s
            pieces = ramp(self.reference.velocity_rad_s, goal_rad_s, drive.acceleration_rad_s2)
            self.reference.follow(pieces, self.reference.position_rad, goal_rad_s)
        elif drive.mode in PROFILED:
            self.reference.follow(self._position_profile(drive), drive.goal_rad)

    def _position_profile(self, drive: DriveCommand) -> list[ProfileSegment]:
        distance_rad = drive.goal_rad - self.reference.position_rad
        now_rad_s = self.reference.velocity_rad_s
        if distance_rad == now_rad_s == 0.0:
            return []
        if drive.profile_time_s > 0.0:
            return timed(distance_rad, now_rad_s, drive.profile_time_s, drive.acceleration_time_s)
        limit_rad_s, slope_rad_s2 = drive.velocity_limit_rad_s, drive.acceleration_rad_s2
        return trapezoid(distance_rad, now_rad_s, limit_rad_s, slope_rad_s2)
