"""A servo's firmware: from the drive's orders to the duty of the bridge."""

from __future__ import annotations

import math

from servosim.drive import Drive, Mode
from servosim.parameters import MotorParameters
from servosim.profile import Piece, Reference, ramp, timed, trapezoid

RELEASED: tuple[object, ...] = (None,)
PROFILED = (Mode.POSITION, Mode.CURRENT_POSITION)


class Controller:
    """The control loop of every mode, on the position and velocity of the output shaft.

    Attributes:
        reference: Where the profile is.
        derivative: The gain that damps: duty for each rad/s.
        saturated: Set by the motor when a limit cut the duty: the integral then waits.
    """

    __slots__ = ("_integral", "_order", "_parameters", "derivative", "reference", "saturated")

    def __init__(self, parameters: MotorParameters, position_rad: float) -> None:
        self._parameters = parameters
        self.reference = Reference(position_rad)
        self._order = RELEASED
        self._integral = self.derivative = 0.0
        self.saturated = False

    def release(self, position_rad: float) -> None:
        """Torque is off: follow the shaft and remember nothing."""
        if self._order is RELEASED:
            self.reference.position_rad = position_rad
            return
        self.reference.put(position_rad)
        self._order = RELEASED
        self._integral = self.derivative = 0.0
        self.saturated = False

    def duty(
        self, dt_s: float, drive: Drive, position_rad: float, velocity_rad_s: float, full_nm: float
    ) -> float:
        """The duty that the gains ask for, not yet limited; the profile then moves on.

        Args:
            dt_s: Time until the next call.
            drive: The orders.
            position_rad: What the sensor sees.
            velocity_rad_s: Its derivative.
            full_nm: Stall torque at the present supply voltage.
        """
        mode = drive.mode
        order = (
            mode, drive.goal_rad, drive.goal_velocity_rad_s, drive.velocity_limit_rad_s,
            drive.acceleration_rad_s2, drive.profile_time_s, drive.acceleration_time_s,
        )  # fmt: skip
        if order != self._order:
            self._take(order, drive, position_rad, velocity_rad_s)
        if mode is Mode.POSITION or mode is Mode.CURRENT_POSITION:
            duty = self._position_duty(dt_s, drive, position_rad, velocity_rad_s)
        elif mode is Mode.VELOCITY:
            duty = self._velocity_duty(dt_s, drive, velocity_rad_s)
        else:
            return drive.goal_pwm if mode is Mode.PWM else math.copysign(1.0, drive.goal_current_a)
        reference = self.reference
        if reference.velocity_rad_s or reference.acceleration_rad_s2:
            duty += drive.feed_forward * self._needed_nm() / full_nm
        if reference.running:
            reference.advance(dt_s)
        return duty

    def _position_duty(
        self, dt_s: float, drive: Drive, position_rad: float, velocity_rad_s: float
    ) -> float:
        reference = self.reference
        error_rad = reference.position_rad - position_rad
        if -drive.dead_zone_rad <= error_rad <= drive.dead_zone_rad and not reference.running:
            error_rad = 0.0
        duty = drive.kp * error_rad
        if drive.ki:
            duty += self._integrate(drive.ki * error_rad * dt_s, drive.integral_limit)
        if drive.minimum_pwm and error_rad and abs(duty) < drive.minimum_pwm:
            duty = math.copysign(drive.minimum_pwm, error_rad)
        self.derivative = drive.kd
        return duty + drive.kd * (reference.velocity_rad_s - velocity_rad_s)

    def _velocity_duty(self, dt_s: float, drive: Drive, velocity_rad_s: float) -> float:
        error_rad_s = self.reference.velocity_rad_s - velocity_rad_s
        self.derivative = drive.velocity_kp
        gained = self._integrate(drive.velocity_ki * error_rad_s * dt_s, drive.integral_limit)
        return drive.velocity_kp * error_rad_s + gained

    def _integrate(self, gain: float, limit: float) -> float:
        if not self.saturated or gain * self._integral < 0.0:
            self._integral = min(limit, max(-limit, self._integral + gain))
        return self._integral

    def _needed_nm(self) -> float:
        """Torque that the profile's motion takes when nothing hangs on the shaft."""
        motor, reference = self._parameters, self.reference
        velocity_rad_s = reference.velocity_rad_s
        needed_nm = motor.armature_kg_m2 * reference.acceleration_rad_s2
        needed_nm += motor.damping_nm_s * velocity_rad_s
        if velocity_rad_s:
            needed_nm += math.copysign(motor.coulomb_friction_nm, velocity_rad_s)
        return needed_nm

    def _take(
        self, order: tuple[object, ...], drive: Drive, position_rad: float, velocity_rad_s: float
    ) -> None:
        """Plan anew; a fresh torque or a fresh mode starts from the shaft itself."""
        if order[0] is not self._order[0]:
            self.reference.put(position_rad, velocity_rad_s)
            self._integral = self.derivative = 0.0
        self._order = order
        if drive.mode is Mode.VELOCITY:
            self._plan_velocity(drive)
        elif drive.mode in PROFILED:
            self.reference.follow(self._position_profile(drive), drive.goal_rad)

    def _plan_velocity(self, drive: Drive) -> None:
        goal_rad_s = drive.goal_velocity_rad_s
        now_rad_s = self.reference.velocity_rad_s
        pieces = ramp(now_rad_s, goal_rad_s, drive.acceleration_rad_s2)
        self.reference.follow(pieces, self.reference.position_rad, goal_rad_s)

    def _position_profile(self, drive: Drive) -> list[Piece]:
        distance_rad = drive.goal_rad - self.reference.position_rad
        now_rad_s = self.reference.velocity_rad_s
        if distance_rad == now_rad_s == 0.0:
            return []
        if drive.profile_time_s > 0.0:
            return timed(distance_rad, now_rad_s, drive.profile_time_s, drive.acceleration_time_s)
        limit_rad_s, slope_rad_s2 = drive.velocity_limit_rad_s, drive.acceleration_rad_s2
        return trapezoid(distance_rad, now_rad_s, limit_rad_s, slope_rad_s2)
