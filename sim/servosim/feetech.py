"""Feetech firmware: clipping, lock, alarms, protections; each series supplies its own part."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from servosim.control import ControlMode
from servosim.frames import Dynamixel1Reader
from servosim.motor import Motor
from servosim.register import ServoTable
from servosim.servo import AlarmBits, BusProtocol, HornMounting, InstructionError, Servo

VOLTAGE, ENCODER, HEAT, CURRENT, OVERLOAD = 0x01, 0x02, 0x04, 0x08, 0x20
CURRENT_UNIT_A = 0.0065
AT_REST_RAD_S = 0.1  # assumed: a shaft that moves faster than this is not blocked


class FeetechProtections(AlarmBits):
    """Protections of a servo; bits clear with their causes, an overload when torque is enabled."""

    def __init__(self, servo: Servo) -> None:
        super().__init__()
        self.servo = servo
        names = servo.table.by_name
        self._limit_name = "torque_limit" if "torque_limit" in names else "max_torque"
        # The unit of the SCS225's current is not known, so the current is ignored.
        self._has_current = "torque_limit" in names and "protection_current" in names
        self._has_overload = "overload_torque" in names
        self.start()

    def start(self) -> None:
        """Start again after power-up."""
        self.bits = self.injected = 0
        self._overload_s = 0.0
        self._over_current_s = 0.0

    @property
    def is_unloaded(self) -> bool:
        """Whether the output is off because of an alarm that the unload condition names."""
        return bool(self.bits & self.servo.memory.get("unload_condition") & ~OVERLOAD)

    def clear_overload(self) -> None:
        """Reset an overload after a write to torque enable."""
        self.bits &= ~(OVERLOAD | CURRENT)
        self._overload_s = self._over_current_s = 0.0
        self.servo.drive.torque_limit = self.torque_limit()

    def torque_limit(self) -> float:
        """Compute the effective limit, 0..1; after an overload it is the protective torque."""
        get = self.servo.memory.get
        limit = min(1.0, get(self._limit_name) / 1000)
        return min(limit, get("protective_torque") / 100) if self.bits & OVERLOAD else limit

    def check(self, dt_s: float) -> None:
        """Run all protections once; ``dt_s`` is the time since the last check."""
        get, servo, motor = self.servo.memory.get, self.servo, self.servo.motor
        volts = round(servo.supply_v * 10)
        self.set_alarm(VOLTAGE, not get("min_voltage_limit") <= volts <= get("max_voltage_limit"))
        self.set_alarm(HEAT, motor.temperature_c > get("max_temperature_limit"))
        if self._has_overload:
            self._check_load(dt_s)
        if self._has_current:
            self._check_current(dt_s)
        if self.bits and self.is_unloaded and servo.drive.torque_on:
            servo.memory.put("torque_enable", 0)
            servo.cut_torque()

    def _check_load(self, dt_s: float) -> None:
        get, motor = self.servo.memory.get, self.servo.motor
        heavy = abs(motor.pwm) * 100 > get("overload_torque")
        blocked = abs(motor.velocity_rad_s) < AT_REST_RAD_S
        if not (heavy and blocked):
            self._overload_s = 0.0
            return
        self._overload_s += dt_s
        if self._overload_s > get("protection_time") * 0.010 and not self.bits & OVERLOAD:
            self.bits |= OVERLOAD
            self.servo.drive.torque_limit = self.torque_limit()
            self.servo.changed()

    def _check_current(self, dt_s: float) -> None:
        get = self.servo.memory.get
        limit_a = get("protection_current") * CURRENT_UNIT_A
        if not abs(self.servo.motor.current_a) > limit_a > 0:
            self._over_current_s = 0.0
            return
        self._over_current_s += dt_s
        if self._over_current_s > get("over_current_time") * 0.010:
            self.bits |= CURRENT


# fmt: off
BAUDS = (1_000_000, 500_000, 250_000, 128_000, 115_200, 76_800, 57_600, 38_400,
         19_200, 14_400, 9_600, 4_800)
# fmt: on
DAMPING = 2  # value of torque_enable that makes the motor brake the shaft
PROTECTED_ERROR_RAD = 1.7  # goals further away get a quarter of the duty (scope)
PHASE_ZERO_IS_MAX = 0x08  # bit that makes goal speed 0 mean the maximum


class FeetechSeries:
    """Differences between the series: units, modes and goals of one servo.

    Attributes:
        bauds: Baud rates by the values of the baud register.
        instructions: The supported instructions.
        answers_broadcast_ping: Whether it replies to a broadcast ping.
        goal_enables_torque: Whether a goal written with torque off switches it on.
    """

    bauds: Mapping[int, float]
    instructions: frozenset[int]
    answers_broadcast_ping = False
    goal_enables_torque = False

    def __init__(self, servo: Feetech) -> None:
        self.servo = servo

    @staticmethod
    def sensor_mounting(shaft: HornMounting, delivered: Mapping[str, int]) -> HornMounting:
        """Return the mounting of the sensor on the horn, before any homing offset is applied."""
        return shaft

    def start(self) -> None:
        """Set the state of the series from the memory after power-up."""

    def present_tick(self) -> int:
        """Return the value of the present position register."""
        return self.servo.shaft.tick_at(self.servo.motor.encoder_rad)

    def angle_at(self, position_tick: int) -> float:
        """Return the joint angle [rad] for a value of the position register."""
        return self.servo.shaft.angle_at(position_tick)

    def calibrate(self, position_tick: int = 2048) -> None:
        """Make the present position the given number, if the series supports it."""

    def nearest_limit(self, goal: int, lower: int, upper: int) -> int:
        """Return the limit that replaces a goal outside of both."""
        return max(lower, min(upper, goal))

    def reset_turns(self) -> None:
        """Reduce the position to a single revolution, if the series counts several."""

    def refresh_goal(self) -> None:
        """Apply the goal again if it depends on the present position."""

    def apply_gains(self) -> None:
        """Apply gains that only this series has."""

    def requested_mode(self) -> ControlMode:
        """Return the mode in the memory."""
        raise NotImplementedError

    def set_goal(self) -> None:
        """Apply goal and profile together after a write to a goal register."""
        raise NotImplementedError

    def live_registers(self) -> dict[str, Callable[[], int]]:
        """Return the getter of each measured register of the series."""
        raise NotImplementedError

    def write_effects(self) -> dict[str, Callable[[], None]]:
        """Return functions to call after writes; they add to or replace those of the family."""
        return {}


class Feetech(Servo):
    """A Feetech servo.

    Args:
        make_series: Makes the series-specific part.
        table: The control table.
        motor: The physics behind it.
        shaft: The zero of reported positions.
        delivered: Registers that differ from the table's defaults.
        seed: The seed of its random numbers.
    """

    protocol = BusProtocol.FEETECH
    framing = Dynamixel1Reader
    registered_flag = "async_write"
    kept_by_recovery = ("id",)
    reboot_s = 0.8  # measured on an STS3215
    kp_per_gain = 0.163  # duty per radian and step of the P gain (pendulum logs, scope)
    # Load registers of servos that held against friction showed (in thousandths of the duty) P / 4
    # per tick of the error beyond the dead zone, plus the start-up force.
    startup_per_unit = 0.001
    kd_per_gain = 0.001  # assumed [s/rad]
    ki_per_gain = 0.05  # assumed [1/(rad s)]

    def __init__(
        self,
        make_series: type[FeetechSeries],
        table: ServoTable,
        motor: Motor,
        shaft: HornMounting,
        delivered: Mapping[str, int] | None = None,
        seed: int = 0,
    ) -> None:
        sensor = make_series.sensor_mounting(shaft, delivered or {})
        super().__init__(table, motor, sensor, delivered, seed)
        self._delays = "return_delay" in table.by_name
        self._gains = (
            ("kp", "kd", "ki") if "kp" in table.by_name else ("p_gain", "d_gain", "i_gain")
        )
        self.bauds, self.instructions = make_series.bauds, make_series.instructions
        self.answers_broadcast_ping = make_series.answers_broadcast_ping
        self.goal_enables_torque = make_series.goal_enables_torque
        self.series = make_series(self)
        self.watch = FeetechProtections(self)
        self.live = self._live_registers() | self.series.live_registers()
        self.effects = self._write_effects() | self.series.write_effects()
        self.start()

    # Status for the line.

    @property
    def return_delay_s(self) -> float:
        """The return delay, from a register in steps of 2 µs; an HLS has none."""
        return self.memory.get("return_delay") * 2e-6 if self._delays else 0.0

    @property
    def status_level(self) -> int:
        """The response level: 1 replies to everything, 0 only to pings and reads."""
        return 2 if self.memory.get("response_level") else 1

    @property
    def alarm(self) -> int:
        """The status register."""
        return self.watch.bits

    @property
    def is_eeprom_unlocked(self) -> bool:
        """Whether the lock register is 0, so that EEPROM writes survive loss of power."""
        return self.memory.get("lock") == 0

    def check_write(self, address: int, data: bytes) -> InstructionError | None:
        """Refuse addresses outside the memory; the registers check the rest."""
        return None if data and address + len(data) <= self.table.size else InstructionError.RANGE

    def store(self, address: int, data: bytes) -> None:
        """Store writable values, each clipped to its range; ignore the rest."""
        end = address + len(data)
        for row in self.table.registers_in(address, len(data)):
            if row.address >= address and row.end <= end:
                raw = data[row.address - address : row.end - address]
            else:
                requested = bytearray(self.memory.image)
                requested[address:end] = data
                raw = bytes(requested[row.address : row.end])
            if row.writable:
                value = row.decode(raw)
                if not row.lower <= value <= row.upper:
                    raw = row.encode(max(row.lower, min(row.upper, value)))
                persist = row.persists and self.is_eeprom_unlocked
                self.memory.write(row.address, raw, persist=persist)
        self.apply_write_effects(address, len(data))

    def run_protections(self, dt_s: float) -> None:
        """Check temperature, load and voltage."""
        self.watch.check(dt_s)
        self.series.refresh_goal()

    def inject_alarm(self, bits: int) -> None:
        """Set alarm bits without a cause, or clear them."""
        self.watch.inject_alarm(bits)

    def is_goal_allowed(self, goal: int) -> bool:
        """Check whether a goal position is inside the limits; both zero means no limits."""
        lower, upper = self.memory.get("min_position_limit"), self.memory.get("max_position_limit")
        return lower == upper == 0 or lower <= goal <= upper

    # Position.

    def present_tick(self) -> int:
        """Return the value of the present position register."""
        return self.series.present_tick()

    def angle_at(self, position_tick: int) -> float:
        """Return the joint angle [rad] for a value of the position register."""
        return self.series.angle_at(position_tick)

    def calibrate(self, position_tick: int = 2048) -> None:
        """Make the present position the given number, if the series supports it."""
        self.series.calibrate(position_tick)

    def reset_turns(self) -> None:
        """Reduce the position to a single revolution, if the series counts several."""
        self.series.reset_turns()

    def hold_position(self) -> None:
        """Make the present position the goal."""
        self.memory.put("goal_position", self.present_tick())
        self.set_goal()

    # From memory to drive.

    def start(self) -> None:
        """Set everything from the memory after power-up; the goal is the present position."""
        self.series.start()
        self.drive.torque_on = False
        self.watch.start()
        self.memory.put("goal_position", self.present_tick())
        for effect in (self.set_gains, self.set_limits, self.set_mode):
            effect()

    def set_torque(self) -> None:
        """Apply a write to torque enable: 0 off, 1 on, 2 damping."""
        self.watch.clear_overload()
        self.drive.torque_on = self.memory.get("torque_enable") != 0
        self.set_mode()

    def set_mode(self) -> None:
        """Apply a write to operating mode or torque."""
        damping = self.memory.get("torque_enable") == DAMPING
        self.drive.mode = ControlMode.PWM if damping else self.series.requested_mode()
        self.set_goal()
        if damping:
            self.drive.goal_pwm = 0.0

    def set_goal(self) -> None:
        """Apply goal and profile together after a write to a goal register."""
        self.series.set_goal()

    def set_gains(self) -> None:
        """Apply the gains in SI units."""
        drive, get = self.drive, self.memory.get
        kp, kd, ki = (get(name) if name in self.table.by_name else 0 for name in self._gains)
        drive.kp = kp * self.kp_per_gain
        drive.kd = kd * self.kd_per_gain
        drive.ki = ki * self.ki_per_gain
        drive.startup_pwm = get("min_startup_force") * self.startup_per_unit
        drive.tick_rad = self.shaft.rad_per_tick
        drive.dead_zone_rad = get("cw_dead_zone") * self.shaft.rad_per_tick
        drive.protected_error_rad = PROTECTED_ERROR_RAD
        self.series.apply_gains()

    def set_limits(self) -> None:
        """Apply the limits; an overload keeps its own torque limit."""
        self.drive.torque_limit = self.watch.torque_limit()

    def clamped_goal(self) -> int:
        """Return the goal position inside the limits; both zero means no limits."""
        get = self.memory.get
        lower, upper = get("min_position_limit"), get("max_position_limit")
        goal = get("goal_position")
        if lower <= goal <= upper or lower == upper == 0:
            return goal
        return self.series.nearest_limit(goal, lower, upper)

    def profile_speed(self, speed_rad_s: float) -> float:
        """Compute the speed limit for a goal speed; 0 means the maximum, or no motion."""
        at_rest = speed_rad_s == 0.0 and not self.memory.get("phase") & PHASE_ZERO_IS_MAX
        return 1e-6 if at_rest else speed_rad_s

    # Tables of measured registers and of write effects.

    def _live_registers(self) -> dict[str, Callable[[], int]]:
        motor = self.motor
        return {
            "present_position": self.present_tick,
            "present_load": lambda: round(self.shaft.sign * motor.pwm * 1000),
            "present_voltage": lambda: round(self.supply_v * 10),
            "present_temperature": lambda: int(motor.temperature_c),
            "status": lambda: self.watch.bits,
            "moving": lambda: int(motor.moving),
        }

    def _write_effects(self) -> dict[str, Callable[[], None]]:
        gains = (*self._gains, "min_startup_force", "cw_dead_zone")
        goals = (
            "goal_time",
            "goal_pwm",
            "goal_torque",
            "goal_speed",
            "phase",
            "min_position_limit",
            "max_position_limit",
        )
        return {
            "torque_enable": self.set_torque,
            "goal_position": self.set_goal,
            **dict.fromkeys(gains, self.set_gains),
            **dict.fromkeys(goals, self.set_goal),
        }
