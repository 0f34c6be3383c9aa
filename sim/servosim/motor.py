"""A servo's motor and gear train with its thermal model."""

from __future__ import annotations

import math

from servosim.control import CURRENT, CURRENT_POSITION, Controller, ControlMode, DriveCommand
from servosim.parameters import PARAMETERS, MotorParameters

__all__ = ["PARAMETERS", "ControlMode", "DriveCommand", "Motor", "MotorParameters"]


class ThermalModel:
    """The temperature at a servo's own sensor.

    `C dT/dt = P - (T - room) / R`, with the winding's loss P. One body for winding and case: the
    sensors of these servos sit on the circuit board between the two.
    """

    __slots__ = ("_capacity_j_k", "_resistance_k_w", "room_c", "temperature_c")

    def __init__(self, capacity_j_k: float, resistance_k_w: float, room_c: float) -> None:
        self._capacity_j_k = capacity_j_k
        self._resistance_k_w = resistance_k_w
        self.room_c = room_c
        self.temperature_c = room_c

    def step(self, dt_s: float, power_w: float) -> None:
        """Advance `dt_s` seconds under a loss of `power_w` watts."""
        flow_w = power_w - (self.temperature_c - self.room_c) / self._resistance_k_w
        self.temperature_c += flow_w * dt_s / self._capacity_j_k


PLAY_HZ = 45.0  # a load moves through the play with this damping: inertia times this rate
AT_REST_RAD_S = 1e-6  # a motion slower than this sticks
FREE_PLAY_FRACTION = 1e-3  # loads below this fraction of the stall torque do not take up the play
STRIBECK_SPAN = 8.0  # beyond this multiple of its velocity the Stribeck friction has gone


# Of a shaft's step: velocity after it without load and dry friction, gain of velocity by a torque,
# by how much dry friction changes it, and the least and greatest for the stops [rad/s, per N m].
ShaftStep = tuple[float, float, float, float, float]


def solve_velocity(shaft: ShaftStep, load_nm: float) -> float:
    """Return the velocity of a shaft after a step under an external torque [rad/s].

    Newton's law; dry friction stops a motion but never reverses it, and no motion passes a stop.
    """
    free_rad_s, per_nm, stop_rad_s, least_rad_s, most_rad_s = shaft
    after_rad_s = free_rad_s + per_nm * load_nm
    if after_rad_s > stop_rad_s + AT_REST_RAD_S:
        after_rad_s -= stop_rad_s
        return after_rad_s if after_rad_s < most_rad_s else most_rad_s
    if after_rad_s < -stop_rad_s - AT_REST_RAD_S:
        after_rad_s += stop_rad_s
        return after_rad_s if after_rad_s > least_rad_s else least_rad_s
    return 0.0


class Motor:
    """A motor that follows a drive and carries a load.

    A voltage-driven direct-current motor behind its gears, seen from the output shaft, with the
    friction model m4 of Duclusaud, Passault et al., "Extended Friction Models for the Physics
    Simulation of Servo Actuators" (2024, Rhoban's BAM), and a part that grows with the square of
    the load as in their m6, here at every speed:

        tau_m = kt i,   i = (u V - kt w) / R,   |i| <= i_max                    motor
        J dw/dt = tau_m + tau_e - kv w - tau_f                                  shaft
        |tau_f| <= kc + kl g + kq g^2 + exp(-|w| / ws) (ks + kls g)             dry friction
        g = |tau_m - tau_e|                                                     load of the gears

    with the duty u, the supply V, the shaft's speed w and the outer torque tau_e. Dry friction is
    what stops the shaft and at most this bound: a servo holds with less than its load (tau_e and
    tau_m oppose each other then, and g is their sum) and a limp one sinks slowly. Model m1 is
    kl = kq = ks = kls = 0; m5 and m6, with other factors for tau_m and tau_e, explain the logs no
    better. A step is implicit in everything that damps and explicit in the rest: the
    stiffest gains stay stable at steps of 1 ms and the steady state is exact.

    The free play is between the gears and the output shaft. The position sensor is on the
    output shaft (magnetic on STS, X and MX, a potentiometer on SCS and AX) and sees the joint:
    the play shows as lost motion when the load changes sides, not as an error of the reading.

    Attributes:
        position_rad: Position of the output shaft: the true joint position.
        velocity_rad_s: Speed of the gears: the shaft's, but while it crosses the play.
        torque_nm: Torque of the motor at the shaft, before friction.
        current_a: Signed current of the winding.
        pwm: Signed duty of the bridge, -1..1.
        lash_rad: Offset of the shaft inside the free play of the gears.
        moving: Whether the shaft is faster than the drive's threshold or the profile runs.
        heat: The thermal model of the servo.
        lower_stop_rad: Where a hard stop holds the shaft.
        upper_stop_rad: Where a hard stop holds the shaft on the other side.
        load_inertia_kg_m2: Inertia of the load on the shaft.
        carried: Another body integrates the motion and sets it by `set_state`; a step only
            computes the torque.
        stuck: A fault: the shaft does not move.
        grip: A fault: the fraction of the motor's torque that reaches the shaft; 1 = sound gears.
    """

    __slots__ = (
        "_back_emf",
        "_controller",
        "_duty",
        "_falling",
        "_free_play_nm",
        "_full_nm",
        "_gear_rad",
        "_half_play_rad",
        "_leaning_nm",
        "_limits_itself",
        "_most_a",
        "_nm_per_a",
        "_nm_per_v",
        "_pressed_nm",
        "_resistance_ohm",
        "_slope",
        "_viscous",
        "carried",
        "current_a",
        "grip",
        "heat",
        "lash_rad",
        "load_inertia_kg_m2",
        "lower_stop_rad",
        "moving",
        "parameters",
        "position_rad",
        "pwm",
        "stuck",
        "torque_nm",
        "upper_stop_rad",
        "velocity_rad_s",
    )  # fmt: skip

    def __init__(
        self,
        parameters: MotorParameters,
        position_rad: float = 0.0,
        lower_stop_rad: float = -math.inf,
        upper_stop_rad: float = math.inf,
        room_c: float = 25.0,
    ) -> None:
        self.parameters = parameters
        self.lower_stop_rad, self.upper_stop_rad = lower_stop_rad, upper_stop_rad
        self.heat = ThermalModel(
            parameters.heat_capacity_j_k, parameters.thermal_resistance_k_w, room_c
        )
        self.load_inertia_kg_m2 = 0.0
        self.carried = self.stuck = False
        self.grip = 1.0
        # The figures below are properties of the parameters; a step reads them several times.
        self._nm_per_a = parameters.torque_constant_nm_a
        self._resistance_ohm = parameters.resistance_ohm
        self._nm_per_v = self._nm_per_a / self._resistance_ohm
        self._back_emf = self._nm_per_a * self._nm_per_v
        self._most_a = parameters.current_limit_a
        self._viscous = parameters.viscous_nm_s
        self._half_play_rad = parameters.backlash_rad / 2.0
        self._free_play_nm = FREE_PLAY_FRACTION * parameters.stall_torque_nm
        self._duty, self._limits_itself = 0.0, False
        self._controller = Controller(position_rad)
        self.place(position_rad)

    def place(self, position_rad: float) -> None:
        """Set the shaft's position inside its stops, at rest, in the middle of its play."""
        position_rad = min(self.upper_stop_rad, max(self.lower_stop_rad, position_rad))
        self._gear_rad = self.position_rad = position_rad
        self.lash_rad = self.velocity_rad_s = self._pressed_nm = self._leaning_nm = 0.0
        self._falling = False
        self.torque_nm = self.current_a = self.pwm = self._slope = self._full_nm = 0.0
        self.moving = False
        self._controller.release(position_rad)

    @property
    def encoder_rad(self) -> float:
        """The position sensor's angle: that of the output shaft."""
        return self.position_rad

    @property
    def inertia_kg_m2(self) -> float:
        """The inertia of the shaft: rotor, gears and load."""
        return self.parameters.armature_kg_m2 + self.load_inertia_kg_m2

    @property
    def temperature_c(self) -> float:
        """The temperature sensor's reading."""
        return self.heat.temperature_c

    @property
    def reference_rad(self) -> float:
        """The position of the profile; the shaft's position while torque is off."""
        return self._controller.reference.position_rad

    @property
    def reference_velocity_rad_s(self) -> float:
        """The velocity of the profile."""
        return self._controller.reference.velocity_rad_s

    @property
    def profile_running(self) -> bool:
        """Whether the profile has not yet reached its end."""
        return self._controller.reference.running

    def step(self, dt_s: float, load_nm: float, drive: DriveCommand, supply_v: float) -> None:
        """Advance `dt_s` seconds (at most 2 ms) under an external torque and a supply voltage.

        Args:
            dt_s: Time that passes [s].
            load_nm: External torque on the shaft [N m]; positive is forward.
            drive: The firmware's commands.
            supply_v: Voltage at the servo's plug [V].
        """
        pressed_nm = self.press(dt_s, drive, supply_v)
        after_rad_s = 0.0
        if not self.carried:
            after_rad_s = solve_velocity(
                self.begin_motion(dt_s, pressed_nm, load_nm, load_nm), load_nm
            )
        self.finish_step(dt_s, drive, after_rad_s)

    # The parts of a step, for shafts that are coupled by what they move.

    def press(self, dt_s: float, drive: DriveCommand, supply_v: float) -> float:
        """Run the controller; return the motor's torque that reaches the shaft, before friction."""
        full_nm = self._nm_per_v * supply_v
        if not drive.torque_on or full_nm <= 0.0:
            self._controller.release(self.position_rad)
            self._slope = self._full_nm = self._pressed_nm = 0.0
            return 0.0
        self._full_nm = full_nm
        controller, velocity_rad_s = self._controller, self.velocity_rad_s
        duty = controller.duty(dt_s, drive, self.position_rad, velocity_rad_s)
        limit = drive.pwm_limit if drive.pwm_limit < drive.torque_limit else drive.torque_limit
        self._slope = self._back_emf + controller.derivative * full_nm
        controller.saturated = not -limit <= duty <= limit
        if controller.saturated:
            duty = math.copysign(limit, duty)
            self._slope = self._back_emf
        self._duty = duty
        torque_nm = full_nm * duty - self._back_emf * velocity_rad_s
        self._pressed_nm = self._limit_torque(torque_nm, drive)
        return self._pressed_nm * self.grip

    def begin_motion(
        self, dt_s: float, pressed_nm: float, load_nm: float, leaning_nm: float
    ) -> ShaftStep:
        """Return the equation of the velocity after the step: inertia, friction, play and stops.

        Args:
            dt_s: Time that passes [s].
            pressed_nm: Torque of the motor that reaches the shaft [N m].
            load_nm: External torque, as far as it is known, with that of accelerations [N m].
            leaning_nm: Without that of accelerations: it decides on which flank of the play the
                shaft leans, and is all of it at rest [N m].
        """
        self._leaning_nm, self._falling = leaning_nm, False
        if self.stuck:
            return 0.0, 0.0, 0.0, 0.0, 0.0
        falling = abs(leaning_nm) > self._free_play_nm and self._take_up_backlash(dt_s, leaning_nm)
        self._falling = falling
        velocity_rad_s, position_rad = self.velocity_rad_s, self.position_rad
        damping = self._slope * self.grip + self._viscous
        inertia = self.parameters.armature_kg_m2 + self.load_inertia_kg_m2
        per_nm = dt_s / (inertia + damping * dt_s)
        geared_nm = 0.0 if falling else load_nm
        least_rad_s = (self.lower_stop_rad - position_rad) / dt_s
        most_rad_s = (self.upper_stop_rad - position_rad) / dt_s
        return (
            velocity_rad_s + per_nm * (pressed_nm - self._viscous * velocity_rad_s),
            0.0 if falling else per_nm,
            per_nm * self._dry_friction(pressed_nm, geared_nm, abs(velocity_rad_s)),
            least_rad_s if least_rad_s < 0.0 else 0.0,
            most_rad_s if most_rad_s > 0.0 else 0.0,
        )

    def finish_step(self, dt_s: float, drive: DriveCommand, after_rad_s: float) -> None:
        """Move the shaft with the velocity after the step, and update the sensors."""
        braked_nm = 0.0
        if not self.carried:
            braked_nm = self._slope * (after_rad_s - self.velocity_rad_s)
            self.velocity_rad_s = after_rad_s
            if after_rad_s or self._falling:
                self._move(dt_s)
        self._update_sensors(dt_s, self._pressed_nm - braked_nm, drive)

    def set_state(self, position_rad: float, velocity_rad_s: float) -> None:
        """Set the state to that of the joint."""
        self.position_rad = position_rad
        self._gear_rad = position_rad - self.lash_rad
        self.velocity_rad_s = velocity_rad_s

    def _limit_torque(self, torque_nm: float, drive: DriveCommand) -> float:
        limit_a, mode = drive.current_limit_a, drive.mode
        if mode is CURRENT or mode is CURRENT_POSITION:
            limit_a = min(limit_a, abs(drive.goal_current_a))
        self._limits_itself = limit_a > self._most_a
        limit_nm = (self._most_a if self._limits_itself else limit_a) * self._nm_per_a
        if -limit_nm <= torque_nm <= limit_nm:
            self._limits_itself = False
            return torque_nm
        self._slope = 0.0
        self._controller.saturated = True
        return math.copysign(limit_nm, torque_nm)

    def _move(self, dt_s: float) -> None:
        """Turn the gears, which take the shaft along but for the play."""
        travel_rad = self.velocity_rad_s * dt_s
        self._gear_rad += travel_rad
        if travel_rad and -self._free_play_nm <= self._leaning_nm <= self._free_play_nm:
            half_rad, lash_rad = self._half_play_rad, self.lash_rad - travel_rad
            inside = -half_rad <= lash_rad <= half_rad
            self.lash_rad = lash_rad if inside else math.copysign(half_rad, lash_rad)
        self.position_rad = self._gear_rad + self.lash_rad
        if not self.lower_stop_rad < self.position_rad < self.upper_stop_rad:
            self._rest_on_stop()

    def _dry_friction(self, pressed_nm: float, load_nm: float, speed_rad_s: float) -> float:
        """The largest torque of the dry friction [N m]."""
        motor, gear_nm = self.parameters, abs(pressed_nm - load_nm)
        friction_nm = motor.friction_nm + gear_nm * (
            motor.load_friction + motor.load_square_per_nm * gear_nm
        )
        span = speed_rad_s / motor.stribeck_rad_s
        if span > STRIBECK_SPAN:
            return friction_nm
        return friction_nm + math.exp(-span) * (motor.stribeck_nm + motor.load_stribeck * gear_nm)

    def _take_up_backlash(self, dt_s: float, load_nm: float) -> bool:
        """Let the load move through the play; true while it has not reached the next tooth."""
        half_rad = self._half_play_rad if load_nm > 0.0 else -self._half_play_rad
        if self.lash_rad == half_rad:
            return False
        sunk_rad = self.lash_rad + load_nm * dt_s / (PLAY_HZ * self.inertia_kg_m2)
        self.lash_rad = min(half_rad, sunk_rad) if load_nm > 0.0 else max(half_rad, sunk_rad)
        return True

    def _rest_on_stop(self) -> None:
        stop_rad = min(self.upper_stop_rad, max(self.lower_stop_rad, self.position_rad))
        self._gear_rad -= self.position_rad - stop_rad
        self.position_rad = stop_rad

    def _update_sensors(self, dt_s: float, torque_nm: float, drive: DriveCommand) -> None:
        """Update the servo's other sensors after the step."""
        self.torque_nm = torque_nm
        current_a = self.current_a = torque_nm / self._nm_per_a
        full_nm, back_emf_nm = self._full_nm, self._back_emf * self.velocity_rad_s
        if self._limits_itself and full_nm:
            self.pwm = self._duty  # the bridge gives it, but the current does not rise
        else:
            self.pwm = (torque_nm + back_emf_nm) / full_nm if full_nm else 0.0
        self.heat.step(dt_s, current_a * current_a * self._resistance_ohm)
        self.moving = (
            self._controller.reference.running
            or abs(self.velocity_rad_s) > drive.moving_threshold_rad_s
        )
