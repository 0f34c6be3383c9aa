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


AT_REST_RAD_S = 1e-6  # a motion slower than this sticks
AT_FLANK_RAD = 1e-12  # an output nearer than this is on the flank; covers rounding
STRIBECK_SPAN = 8.0  # above this multiple of its velocity Stribeck friction is zero
# The output gear's and the horn's part of the armature, 10 g at a radius of gyration of 10 mm
# (estimate): the mass that crosses the backlash when a joint carries nothing.
OUTPUT_INERTIA_KG_M2 = 1e-6


# Values of a joint's step, in rad/s and rad/s per N m. Output alone: its velocity after the step
# without load and dry friction, gain of velocity by a torque, change by its friction, smallest and
# largest velocity for the stops. Rotor alone: its velocity after the step. Relative velocities at
# which the output reaches the flank behind and ahead. Both as one: velocity and gain, change by the
# output's and by the rotor's friction, and the rotor's fraction of the inertia.
JointStep = tuple[
    float, float, float, float, float, float, float, float, float, float, float, float, float
]
_FREE = -math.inf, math.inf
_STUCK: JointStep = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, *_FREE, 0.0, 0.0, 0.0, 0.0, 0.0)


def solve_velocity(step: JointStep, load_nm: float) -> float:
    """Compute the velocity of the output after a step under an external torque [rad/s].

    Newton's law for rotor and output, which meet at the flanks of the backlash without a rebound: a
    complementarity problem in the velocities after the step (Moreau 1988, "Unilateral contact and
    dry friction in finite freedom dynamics"; Jean 1999), of one dimension, so it has a closed form.
    Dry friction stops a motion but never reverses it, and no motion passes a stop.
    """
    (
        free_rad_s, per_nm, stop_rad_s, least_rad_s, most_rad_s, rotor_rad_s, behind_rad_s,
        ahead_rad_s, pair_rad_s, pair_per_nm, output_stop, rotor_stop, share,
    ) = step  # fmt: skip
    after_rad_s = free_rad_s + per_nm * load_nm
    if after_rad_s > stop_rad_s + AT_REST_RAD_S:
        after_rad_s -= stop_rad_s
        after_rad_s = after_rad_s if after_rad_s < most_rad_s else most_rad_s
    elif after_rad_s < -stop_rad_s - AT_REST_RAD_S:
        after_rad_s += stop_rad_s
        after_rad_s = after_rad_s if after_rad_s > least_rad_s else least_rad_s
    else:
        after_rad_s = 0.0
    apart_rad_s = after_rad_s - rotor_rad_s
    if behind_rad_s <= apart_rad_s <= ahead_rad_s:
        return after_rad_s
    met_rad_s = ahead_rad_s if apart_rad_s > ahead_rad_s else behind_rad_s
    after_rad_s = pair_rad_s + pair_per_nm * load_nm
    if met_rad_s:
        after_rad_s = _stopped_pair(
            after_rad_s + share * met_rad_s, output_stop, rotor_stop, met_rad_s
        )
    else:
        stop_rad_s = output_stop + rotor_stop
        if after_rad_s > stop_rad_s + AT_REST_RAD_S:
            after_rad_s -= stop_rad_s
        elif after_rad_s < -stop_rad_s - AT_REST_RAD_S:
            after_rad_s += stop_rad_s
        else:
            return 0.0
    if after_rad_s > most_rad_s:
        return most_rad_s
    return after_rad_s if after_rad_s > least_rad_s else least_rad_s


def _stopped_pair(
    free_rad_s: float, output_stop: float, rotor_stop: float, met_rad_s: float
) -> float:
    """Compute the output's velocity with dry friction, in the step that ends at a flank.

    The output's friction acts against its velocity, the rotor's against that minus `met_rad_s`.
    """
    (low_rad_s, low), (high_rad_s, high) = sorted(((0.0, output_stop), (met_rad_s, rotor_stop)))
    if free_rad_s + low + high < low_rad_s:
        return free_rad_s + low + high
    if free_rad_s - low + high <= low_rad_s:
        return low_rad_s
    if free_rad_s - low + high < high_rad_s:
        return free_rad_s - low + high
    return max(high_rad_s, free_rad_s - low - high)


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

    with the duty u, the supply V, the rotor's speed w and the outer torque tau_e. Dry friction
    stops the shaft and is at most this bound: a servo holds with less than its load (tau_e and
    tau_m then oppose each other, and g is their sum) and a limp one sinks slowly. Model m1 is kl =
    kq = ks = kls = 0; m5 and m6, with other factors for tau_m and tau_e, do not explain the logs
    better. A step is implicit in all damping and explicit in the rest: the stiffest gains stay
    stable at steps of 1 ms and the steady state is exact.

    This holds for rotor and gears on the flank that carries the load. There are two bodies: the
    rotor with the armature, and the output with its load, with the backlash between them. The
    output has the part ko of the friction and kvo of kv, both against the housing; the rotor has
    the rest. Inside the backlash no torque passes: the rotor turns under the motor and its own
    friction (g = |tau_m|), the output under tau_e and its own. They meet without a rebound. The
    position sensor is on the output (magnetic on STS, X and MX, a potentiometer on SCS and AX).

    Attributes:
        position_rad: Position of the output shaft: the true joint position.
        velocity_rad_s: Speed of the output shaft.
        rotor_rad_s: Speed of rotor and gears, at the output.
        torque_nm: Torque of the motor at the shaft, before friction.
        current_a: Signed current of the winding.
        pwm: Signed duty of the bridge, -1..1.
        lash_rad: The angle of the output ahead of the middle of the backlash.
        moving: Whether the shaft is faster than the drive's threshold or the profile runs.
        heat: The thermal model of the servo.
        lower_stop_rad: The position of a hard stop of the shaft.
        upper_stop_rad: The position of the hard stop on the other side.
        load_inertia_kg_m2: Inertia of the load on the output.
        carried: Whether another body integrates the motion and sets it by `set_state`; a step only
            computes the torque.
        stuck: A fault: the shaft does not move.
        grip: A fault: the fraction of the motor's torque that reaches the shaft; 1 = sound gears.
    """

    __slots__ = (
        "_ahead_rad_s",
        "_alone_rad_s",
        "_back_emf",
        "_behind_rad_s",
        "_braking",
        "_controller",
        "_damping",
        "_duty",
        "_full_nm",
        "_half_play_rad",
        "_limits_itself",
        "_most_a",
        "_nm_per_a",
        "_nm_per_v",
        "_output_nm",
        "_output_viscous",
        "_pressed_nm",
        "_resistance_ohm",
        "_rotor_inertia",
        "_rotor_viscous",
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
        "rotor_rad_s",
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
        # The values below are properties of the parameters; a step reads them several times.
        self._nm_per_a = parameters.torque_constant_nm_a
        self._resistance_ohm = parameters.resistance_ohm
        self._nm_per_v = self._nm_per_a / self._resistance_ohm
        self._back_emf = self._nm_per_a * self._nm_per_v
        self._most_a = parameters.current_limit_a
        dry_nm = parameters.friction_nm + parameters.stribeck_nm
        self._output_nm = min(parameters.output_friction_nm, dry_nm)
        self._output_viscous = min(parameters.output_viscous_nm_s, parameters.viscous_nm_s)
        self._rotor_viscous = parameters.viscous_nm_s - self._output_viscous
        self._rotor_inertia = parameters.armature_kg_m2 - OUTPUT_INERTIA_KG_M2
        self._half_play_rad = parameters.backlash_rad / 2.0
        self._duty, self._limits_itself = 0.0, False
        self._controller = Controller(position_rad)
        self.place(position_rad)

    def place(self, position_rad: float) -> None:
        """Set the output's position inside its stops, at rest, in the middle of the backlash."""
        self.position_rad = min(self.upper_stop_rad, max(self.lower_stop_rad, position_rad))
        self.lash_rad = self.velocity_rad_s = self.rotor_rad_s = self._pressed_nm = 0.0
        self._alone_rad_s = self._behind_rad_s = self._ahead_rad_s = 0.0
        self.torque_nm = self.current_a = self.pwm = self._full_nm = 0.0
        self._braking = self._damping = 0.0
        self.moving = False
        self._controller.release(self.position_rad)

    @property
    def encoder_rad(self) -> float:
        """The position sensor's angle, which is that of the output."""
        return self.position_rad

    @property
    def is_on_flank(self) -> bool:
        """Whether the output touches a tooth of the gears, on either side of the backlash."""
        return abs(self.lash_rad) >= self._half_play_rad

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
            dt_s: Duration of the step [s].
            load_nm: External torque on the shaft [N m]; positive is forward.
            drive: The firmware's commands.
            supply_v: Voltage at the servo's plug [V].
        """
        pressed_nm = self.press(dt_s, drive, supply_v)
        after_rad_s = 0.0
        if not self.carried:
            after_rad_s = solve_velocity(self.begin_motion(dt_s, pressed_nm, load_nm), load_nm)
        self.finish_step(dt_s, drive, after_rad_s)

    # The parts of a step, for outputs that are coupled by their load.

    def press(self, dt_s: float, drive: DriveCommand, supply_v: float) -> float:
        """Run the controller; return the motor's torque that reaches the gears, before friction."""
        full_nm = self._nm_per_v * supply_v
        if not drive.torque_on or full_nm <= 0.0:
            self._controller.release(self.position_rad)
            self._braking = self._damping = self._full_nm = self._pressed_nm = 0.0
            return 0.0
        self._full_nm = full_nm
        controller = self._controller
        duty = controller.duty(dt_s, drive, self.position_rad, self.velocity_rad_s)
        limit = drive.pwm_limit if drive.pwm_limit < drive.torque_limit else drive.torque_limit
        self._braking, self._damping = self._back_emf, controller.derivative * full_nm
        controller.saturated = not -limit <= duty <= limit
        if controller.saturated:
            duty = math.copysign(limit, duty)
            self._damping = 0.0
        self._duty = duty
        torque_nm = full_nm * duty - self._back_emf * self.rotor_rad_s
        self._pressed_nm = self._limit_torque(torque_nm, drive)
        return self._pressed_nm * self.grip

    def begin_motion(
        self, dt_s: float, pressed_nm: float, load_nm: float, held_nm_s: float = 0.0
    ) -> JointStep:
        """Compute the equations of velocities after the step: inertia, friction, backlash, stops.

        Args:
            dt_s: Duration of the step [s].
            pressed_nm: Torque of the motor that reaches the gears [N m].
            load_nm: External torque, as far as known, including that of accelerations [N m].
            held_nm_s: Decrease of the external torque per speed of the output [N m s].
        """
        if self.stuck:
            self._alone_rad_s, self._behind_rad_s, self._ahead_rad_s = 0.0, -math.inf, math.inf
            return _STUCK
        rotor_rad_s, output_rad_s = self.rotor_rad_s, self.velocity_rad_s
        output_nm = self._output_nm
        motor, viscous = self.parameters, self._rotor_viscous
        grease = self._output_viscous + held_nm_s
        gear_nm = abs(pressed_nm - load_nm + held_nm_s * output_rad_s)
        alone_nm = abs(pressed_nm)
        base_nm, slope = motor.friction_nm - output_nm, motor.load_friction
        span = abs(rotor_rad_s) / motor.stribeck_rad_s
        if span < STRIBECK_SPAN:
            slowness = math.exp(-span)
            base_nm += slowness * motor.stribeck_nm
            slope += slowness * motor.load_stribeck
        square = motor.load_square_per_nm
        gear_nm = base_nm + gear_nm * (slope + square * gear_nm)
        alone_nm = base_nm + alone_nm * (slope + square * alone_nm)
        # The rotor by itself.
        rotor = self._rotor_inertia + (self._braking * self.grip + viscous) * dt_s
        driven_nm = pressed_nm - viscous * rotor_rad_s
        alone_rad_s, stop_rad_s = rotor_rad_s + driven_nm * dt_s / rotor, alone_nm * dt_s / rotor
        if alone_nm < 0.0:
            stop_rad_s = 0.0
        if alone_rad_s > stop_rad_s + AT_REST_RAD_S:
            alone_rad_s -= stop_rad_s
        elif alone_rad_s < -stop_rad_s - AT_REST_RAD_S:
            alone_rad_s += stop_rad_s
        else:
            alone_rad_s = 0.0
        # The output by itself, and both as one, which the D gain brakes as well.
        carried = self.load_inertia_kg_m2 + OUTPUT_INERTIA_KG_M2
        per_nm = dt_s / (carried + grease * dt_s)
        output = carried + (grease + self._damping * self.grip) * dt_s
        both = rotor + output
        geared_nm = driven_nm - grease * output_rad_s
        half_rad, lash_rad, position_rad = self._half_play_rad, self.lash_rad, self.position_rad
        least_rad_s = (self.lower_stop_rad - position_rad) / dt_s
        most_rad_s = (self.upper_stop_rad - position_rad) / dt_s
        self._alone_rad_s = alone_rad_s
        self._behind_rad_s = behind_rad_s = (-half_rad - lash_rad) / dt_s
        self._ahead_rad_s = ahead_rad_s = (half_rad - lash_rad) / dt_s
        return (
            output_rad_s - per_nm * grease * output_rad_s,
            per_nm,
            per_nm * output_nm,
            least_rad_s if least_rad_s < 0.0 else 0.0,
            most_rad_s if most_rad_s > 0.0 else 0.0,
            alone_rad_s,
            behind_rad_s,
            ahead_rad_s,
            (rotor * rotor_rad_s + output * output_rad_s + geared_nm * dt_s) / both,
            dt_s / both,
            output_nm * dt_s / both,
            gear_nm * dt_s / both if gear_nm > 0.0 else 0.0,
            rotor / both,
        )

    def finish_step(self, dt_s: float, drive: DriveCommand, after_rad_s: float) -> None:
        """Move output and rotor with the output's velocity after the step; update the sensors."""
        braked_nm = 0.0
        if not self.carried:
            rotor_rad_s = self._alone_rad_s
            if after_rad_s - rotor_rad_s > self._ahead_rad_s:
                rotor_rad_s = after_rad_s - self._ahead_rad_s
            elif after_rad_s - rotor_rad_s < self._behind_rad_s:
                rotor_rad_s = after_rad_s - self._behind_rad_s
            braked_nm = self._braking * (rotor_rad_s - self.rotor_rad_s)
            braked_nm += self._damping * (after_rad_s - self.velocity_rad_s)
            self.velocity_rad_s, self.rotor_rad_s = after_rad_s, rotor_rad_s
            if after_rad_s or rotor_rad_s:
                self._move(dt_s)
        self._update_sensors(dt_s, self._pressed_nm - braked_nm, drive)

    def set_state(
        self,
        position_rad: float,
        velocity_rad_s: float,
        lash_rad: float | None = None,
        rotor_rad_s: float | None = None,
    ) -> None:
        """Set the state of the output; a rotor without a given state turns with it."""
        self.position_rad, self.velocity_rad_s = position_rad, velocity_rad_s
        self.lash_rad = self.lash_rad if lash_rad is None else lash_rad
        self.rotor_rad_s = velocity_rad_s if rotor_rad_s is None else rotor_rad_s

    def _limit_torque(self, torque_nm: float, drive: DriveCommand) -> float:
        limit_a, mode = drive.current_limit_a, drive.mode
        if mode is CURRENT or mode is CURRENT_POSITION:
            limit_a = min(limit_a, abs(drive.goal_current_a))
        self._limits_itself = limit_a > self._most_a
        limit_nm = (self._most_a if self._limits_itself else limit_a) * self._nm_per_a
        if -limit_nm <= torque_nm <= limit_nm:
            self._limits_itself = False
            return torque_nm
        self._braking = self._damping = 0.0
        self._controller.saturated = True
        return math.copysign(limit_nm, torque_nm)

    def _move(self, dt_s: float) -> None:
        """Turn rotor and output."""
        position_rad = self.position_rad + self.velocity_rad_s * dt_s
        lash_rad = self.lash_rad + (self.velocity_rad_s - self.rotor_rad_s) * dt_s
        nearly_half_rad = self._half_play_rad - AT_FLANK_RAD
        if not -nearly_half_rad < lash_rad < nearly_half_rad:
            lash_rad = math.copysign(self._half_play_rad, lash_rad)
        self.position_rad, self.lash_rad = position_rad, lash_rad
        if not self.lower_stop_rad < position_rad < self.upper_stop_rad:
            self.position_rad = min(self.upper_stop_rad, max(self.lower_stop_rad, position_rad))

    def _update_sensors(self, dt_s: float, torque_nm: float, drive: DriveCommand) -> None:
        """Update the servo's other sensors after the step."""
        self.torque_nm = torque_nm
        current_a = self.current_a = torque_nm / self._nm_per_a
        full_nm, back_emf_nm = self._full_nm, self._back_emf * self.rotor_rad_s
        if self._limits_itself and full_nm:
            self.pwm = self._duty  # the bridge gives this duty, but the current does not rise
        else:
            self.pwm = (torque_nm + back_emf_nm) / full_nm if full_nm else 0.0
        self.heat.step(dt_s, current_a * current_a * self._resistance_ohm)
        self.moving = (
            self._controller.reference.running
            or abs(self.velocity_rad_s) > drive.moving_threshold_rad_s
        )
