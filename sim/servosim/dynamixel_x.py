"""Dynamixel X firmware: operating modes, profiles, units (e-manual, sections 2.4.1 ff.)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

from servosim.control import ControlMode
from servosim.dynamixel_x_protection import AccessRules, ControlTableBackup, DynamixelXProtections
from servosim.motor import Motor
from servosim.register import ServoTable
from servosim.servo import BusProtocol, HornMounting, InstructionError, Servo

VELOCITY_RAD_S = 0.229 * 2.0 * math.pi / 60.0
ACCELERATION_RAD_S2 = 214.577 * 2.0 * math.pi / 3600.0
PWM_FULL = 885  # steps of 0.113 %
TICKS_PER_RAD = 4096 / (2.0 * math.pi)
CONTROL_HZ = 1000.0  # assumed rate of the position loop that the I and D gains refer to


class DriveMapper:
    """Applies one servo's registers to its drive, in SI units.

    Attributes:
        servo: The servo.
        senses_current: Whether the model has a current sensor.
        current_unit_a: One step of its current registers.
    """

    def __init__(self, servo: SimulatedDynamixelX) -> None:
        self.servo = servo
        self.senses_current = "goal_current" in servo.table.by_name
        is_small = "pwm_slope" in servo.table.by_name
        self.current_unit_a = 0.001 if is_small else 0.00269
        # Measured as PWM per error in pendulum logs of the XL330; assumed for the XC330.
        self._p_divisor = 256 if is_small else 128
        self._profile = (0.0, 0.0, 0.0, 0.0)  # times, then limits, as the drive has them

    def set_position_goal(self) -> None:
        """Apply a write to a goal position, with its profile."""
        drive = self.servo.drive
        (
            drive.profile_time_s, drive.acceleration_time_s,
            drive.velocity_limit_rad_s, drive.acceleration_rad_s2,
        ) = self._profile  # fmt: skip
        drive.goal_rad = self.servo.angle_at(self.servo.memory.get("goal_position"))

    def set_goal(self) -> None:
        """Apply all goal registers, after a write to one of them or a change of their meaning."""
        self.set_position_goal()
        drive, get, sign = self.servo.drive, self.servo.memory.get, self.servo.direction
        drive.goal_velocity_rad_s = sign * get("goal_velocity") * VELOCITY_RAD_S
        goal_pwm = get("goal_pwm") / PWM_FULL
        drive.goal_pwm = sign * goal_pwm
        limit = get("pwm_limit") / PWM_FULL
        drive.pwm_limit = limit if self.servo.mode == 16 else min(limit, abs(goal_pwm))
        if self.senses_current:
            drive.goal_current_a = sign * get("goal_current") * self.current_unit_a

    def update_profile(self) -> None:
        """Apply profile registers, velocities or times (drive mode bit 2), to the next goal."""
        get = self.servo.memory.get
        velocity, acceleration = get("profile_velocity"), get("profile_acceleration")
        if get("drive_mode") & 4:
            self._profile = (velocity / 1000, min(acceleration, velocity / 2) / 1000, 0.0, 0.0)
            return
        limit = min(velocity, get("velocity_limit")) or velocity
        self._profile = (0.0, 0.0, limit * VELOCITY_RAD_S, acceleration * ACCELERATION_RAD_S2)

    def apply_settings(self) -> None:
        """Apply gains and profile, as in the control table."""
        self.set_gains()
        self.update_profile()

    def set_gains(self) -> None:
        """Apply the gains in SI units; datasheets give outputs in PWM steps, errors in ticks."""
        drive, get = self.servo.drive, self.servo.memory.get
        drive.kp = get("position_p_gain") / self._p_divisor * TICKS_PER_RAD / PWM_FULL
        drive.ki = get("position_i_gain") / 65536 * TICKS_PER_RAD * CONTROL_HZ / PWM_FULL
        drive.kd = get("position_d_gain") / 16 * TICKS_PER_RAD / CONTROL_HZ / PWM_FULL
        per_velocity = TICKS_PER_RAD / CONTROL_HZ / PWM_FULL
        drive.velocity_feed_forward = get("feedforward_1st_gain") / 4 * per_velocity
        drive.acceleration_feed_forward = (
            get("feedforward_2nd_gain") / 4 * per_velocity / CONTROL_HZ
        )
        drive.tick_rad = self.servo.shaft.rad_per_tick
        drive.velocity_kp = get("velocity_p_gain") / 128 / VELOCITY_RAD_S / PWM_FULL
        drive.velocity_ki = get("velocity_i_gain") / 65536 * CONTROL_HZ / VELOCITY_RAD_S / PWM_FULL

    def set_limits(self) -> None:
        """Apply the limits of the EEPROM."""
        drive, get = self.servo.drive, self.servo.memory.get
        drive.moving_threshold_rad_s = get("moving_threshold") * VELOCITY_RAD_S
        drive.current_limit_a = math.inf  # unlimited in other modes (e-manual, Current Limit)
        if self.senses_current and self.servo.mode in CURRENT_MODES:
            drive.current_limit_a = get("current_limit") * self.current_unit_a


def live_registers(servo: SimulatedDynamixelX) -> dict[str, Callable[[], int]]:
    """Return the getter of each measured register."""
    motor = servo.motor
    stall_nm, unit_a = motor.parameters.stall_torque_nm, servo.orders.current_unit_a

    def speed(velocity_rad_s: float) -> int:
        return round(servo.direction * velocity_rad_s / VELOCITY_RAD_S)

    return {
        "present_position": servo.present_tick,
        "present_velocity": lambda: speed(motor.velocity_rad_s),
        "present_pwm": lambda: round(servo.direction * motor.pwm * PWM_FULL),
        "present_current": lambda: round(servo.direction * motor.current_a / unit_a),
        "present_load": lambda: round(servo.direction * motor.torque_nm / stall_nm * 1000),
        "velocity_trajectory": lambda: speed(motor.reference_velocity_rad_s),
        "position_trajectory": servo.trajectory_tick,
        "present_input_voltage": lambda: round(servo.supply_v * 10),
        "present_temperature": lambda: int(motor.temperature_c),
        "realtime_tick": lambda: int((servo.time_s - servo.boot_s) * 1000) % 32768,
        "moving": lambda: int(motor.moving),
        "backup_ready": lambda: int(servo.backup.is_available),
        "moving_status": servo.watch.moving_status,
    }


def write_effects(servo: SimulatedDynamixelX) -> dict[str, Callable[[], None]]:
    """Return the function to call after a write to each register."""
    orders = servo.orders
    groups: dict[Callable[[], None], tuple[str, ...]] = {
        servo.set_mode: ("operating_mode",),
        servo.set_drive_mode: ("drive_mode",),
        servo.set_protocol: ("protocol_type",),
        servo.set_torque: ("torque_enable",),
        servo.set_position_goal: ("goal_position",),
        servo.watch.start_watchdog: ("bus_watchdog",),
        servo.reset_goals_to_present: ("pwm_limit", "homing_offset"),
        orders.set_goal: ("goal_pwm", "goal_current", "goal_velocity"),
        orders.update_profile: ("profile_velocity", "profile_acceleration", "velocity_limit"),
        orders.set_limits: ("moving_threshold", "current_limit"),
        orders.set_gains: (
            "position_p_gain", "position_i_gain", "position_d_gain",
            "feedforward_1st_gain", "feedforward_2nd_gain",
            "velocity_p_gain", "velocity_i_gain",
        ),
    }  # fmt: skip
    return {name: effect for effect, names in groups.items() for name in names}


BAUDS = (9600, 57600, 115200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)
PROTOCOL_1_ALARMS = 0x25  # voltage, heat and overload have the same bits in both protocols

POLLED_REGISTERS = (  # one-byte registers that are read for each frame on the line
    "secondary_id", "return_delay_time", "status_return_level", "hardware_error_status",
)  # fmt: skip
MODES = {
    0: ControlMode.CURRENT,
    1: ControlMode.VELOCITY,
    3: ControlMode.POSITION,
    4: ControlMode.POSITION,
    5: ControlMode.CURRENT_POSITION,
    16: ControlMode.PWM,
}
CURRENT_MODES = (0, 5)


class SimulatedDynamixelX(Servo):
    """An X-series servo."""

    reboot_s = 0.4  # measured on an XC330
    hears_while_replying = False  # answers only one of several waiting packets
    instructions = frozenset((1, 2, 3, 4, 5, 6, 8, 0x83, 0x92))
    bauds = MappingProxyType(dict(enumerate(BAUDS)))

    def __init__(
        self,
        table: ServoTable,
        motor: Motor,
        shaft: HornMounting,
        delivered: Mapping[str, int] | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(table, motor, shaft, delivered, seed)
        self._to_sensor_tick(delivered or {})
        self._second_at, self._delay_at, self._level_at, self._error_at = (
            table.by_name[name].address for name in POLLED_REGISTERS
        )
        self.turn_base_tick = 0
        self.mode = 3
        self.reversed = False
        self.orders = DriveMapper(self)
        self.watch = DynamixelXProtections(self, lambda: self.mode, self.hold_position)
        self.rules = AccessRules(self, self.watch, self.modes, lambda: self.mode)
        self.backup = ControlTableBackup(self, self.orders.apply_settings)
        self.live = live_registers(self)
        self.effects = write_effects(self)
        self.start()

    # Status for the line.

    @property
    def return_delay_s(self) -> float:
        """The return delay, from a register in steps of 2 µs."""
        return self.memory.image[self._delay_at] * 2e-6

    @property
    def status_level(self) -> int:
        """The status return level register."""
        return self.memory.image[self._level_at]

    @property
    def secondary_id(self) -> int | None:
        """The secondary id register, while it is active."""
        second = self.memory.image[self._second_at]
        return second if second <= 252 and second != self.id else None

    @property
    def alarm(self) -> int:
        """The alarm bits of a status packet; protocol 2.0 has one bit for all causes."""
        bits = self.memory.image[self._error_at]
        if not bits:
            return 0
        return bits & PROTOCOL_1_ALARMS if self.protocol is BusProtocol.DYNAMIXEL_1 else 0x80

    def check_write(self, address: int, data: bytes) -> InstructionError | None:
        """Check a write by the rules of the family."""
        return self.rules.check_write(address, data)

    def read_bytes(self, address: int, length: int) -> bytes:
        """Read, following indirect addresses."""
        if address + length <= self.rules.first_data:
            return super().read_bytes(address, length)
        return self.rules.read(address, length, super().read_bytes)

    def store(self, address: int, data: bytes) -> None:
        """Store, following indirect addresses."""
        if address + len(data) <= self.rules.first_data:
            super().store(address, data)
        else:
            self.rules.store(address, data, super().store)

    def run_protections(self, dt_s: float) -> None:
        """Check temperature, load, voltage and the bus."""
        self.watch.check(dt_s)

    def inject_alarm(self, bits: int) -> None:
        """Raise hardware error bits; only a reboot clears them."""
        if bits:
            self.watch.raise_alarm(bits)

    def is_goal_allowed(self, goal: int) -> bool:
        """Check whether a goal position is inside the limits of position mode."""
        if self.mode != 3:
            return True
        return (
            self.memory.get("min_position_limit") <= goal <= self.memory.get("max_position_limit")
        )

    # Position.

    @property
    def modes(self) -> tuple[int, ...]:
        """Operating modes of this model; current modes need a current sensor."""
        return tuple(MODES) if self.orders.senses_current else (1, 3, 4, 16)

    @property
    def offset_tick(self) -> int:
        """The effective homing offset: position mode ignores more than a quarter revolution."""
        offset = self.memory.get("homing_offset")
        return offset if self.mode != 3 or abs(offset) <= 1024 else 0

    def actual_tick(self) -> int:
        """Compute the sensor's multi-turn tick, in the direction of the drive mode."""
        tick = self.shaft.tick_at(self.motor.encoder_rad)
        return -tick if self.reversed else tick

    def present_tick(self) -> int:
        """Compute the value of the present position register."""
        return self.actual_tick() - self.turn_base_tick + self.offset_tick

    def angle_at(self, position_tick: int) -> float:
        """Compute the joint angle [rad] for a value of the position register."""
        tick = position_tick - self.offset_tick + self.turn_base_tick
        return self.shaft.angle_at(-tick if self.reversed else tick)

    def reset_turns(self) -> None:
        """Reduce the present position to a single revolution."""
        self.turn_base_tick = self.actual_tick() // 4096 * 4096

    @property
    def direction(self) -> int:
        """Sign between registers and the joint's coordinate."""
        return -self.shaft.sign if self.reversed else self.shaft.sign

    # From memory to drive.

    def set_protocol(self) -> None:
        """Apply a write to the protocol type: 1 selects protocol 1.0."""
        old = self.memory.get("protocol_type") == 1
        self.protocol = BusProtocol.DYNAMIXEL_1 if old else BusProtocol.DYNAMIXEL_2
        self.framing = self.protocol.framing

    def start(self) -> None:
        """Set everything from the memory after power-up."""
        self.set_protocol()
        self.reversed = bool(self.memory.get("drive_mode") & 1)
        self.drive.torque_on = False
        self.watch.start()
        self.mode = self.memory.get("operating_mode")
        self.reset_turns()
        self._reset_goals()
        self.drive.mode = MODES.get(self.mode, ControlMode.POSITION)
        for effect in (self.orders.set_gains, self.orders.set_limits, self.orders.set_goal):
            effect()
        has_startup = "startup_configuration" in self.table.by_name
        startup = self.memory.get("startup_configuration") if has_startup else 0
        if startup & 2:
            self.backup.restore()
        if startup & 1:
            self.memory.put("torque_enable", 1)
            self.set_torque()

    def set_mode(self) -> None:
        """Apply a new operating mode: default gains, profile, goals; positions within a turn."""
        mode = self.memory.get("operating_mode")
        if mode == self.mode:
            return
        self.mode = mode
        for name in ("position_p_gain", "position_i_gain", "position_d_gain", "velocity_p_gain",
                     "velocity_i_gain", "feedforward_1st_gain", "feedforward_2nd_gain",
                     "profile_velocity", "profile_acceleration"):  # fmt: skip
            self.memory.put(name, self.table.by_name[name].default)
        self.reset_turns()
        self._reset_goals()
        self.drive.mode = MODES[mode]
        for effect in (self.orders.set_gains, self.orders.set_limits, self.orders.set_goal):
            effect()

    def set_drive_mode(self) -> None:
        """Apply a write to the drive mode: bit 0 reverses the direction of positions."""
        self.reversed = bool(self.memory.get("drive_mode") & 1)
        self.reset_goals_to_present()

    def set_torque(self) -> None:
        """Apply a write to torque enable; in position mode, this resets positions to one turn."""
        on = bool(self.memory.get("torque_enable"))
        if on and not self.drive.torque_on and self.mode == 3:
            self.reset_turns()
        self.drive.torque_on = on
        if on:
            self.orders.set_goal()

    def set_position_goal(self) -> None:
        """Apply a write to the goal position; with drive mode bit 3 it enables torque."""
        if self.memory.get("drive_mode") & 8 and not self.drive.torque_on:
            self.memory.put("torque_enable", 1)
            self.set_torque()
        self.orders.set_position_goal()

    def trajectory_tick(self) -> int:
        """Compute the value of the position trajectory register."""
        tick = self.shaft.tick_at(self.motor.reference_rad)
        return (-tick if self.reversed else tick) - self.turn_base_tick + self.offset_tick

    def reset_goals_to_present(self) -> None:
        """Start from the present position after the meaning of goals has changed."""
        self._reset_goals()
        self.orders.set_goal()

    def hold_position(self) -> None:
        """Stop the servo for the bus watchdog, without a profile."""
        for name in ("profile_velocity", "profile_acceleration", "goal_velocity"):
            self.memory.put(name, 0)
        self.orders.update_profile()
        self.memory.put("goal_position", self.present_tick())
        for mode, name in ((16, "goal_pwm"), (0, "goal_current")):
            if self.mode == mode:
                self.memory.put(name, 0)
        self.orders.set_goal()
        self.changed()

    def _reset_goals(self) -> None:
        self.orders.update_profile()
        put, get = self.memory.put, self.memory.get
        put("goal_position", self.present_tick())
        put("goal_velocity", 0)
        put("goal_pwm", get("pwm_limit"))
        if self.orders.senses_current:
            put("goal_current", get("current_limit"))

    def _to_sensor_tick(self, delivered: Mapping[str, int]) -> None:
        """Convert a zero tick of reported positions to one of the bare sensor."""
        tick = self.shaft.zero_tick - delivered.get("homing_offset", 0)
        if delivered.get("drive_mode", 0) & 1:
            self.shaft = HornMounting(-self.shaft.sign, -tick, self.shaft.ticks)
        else:
            self.shaft = HornMounting(self.shaft.sign, tick, self.shaft.ticks)
