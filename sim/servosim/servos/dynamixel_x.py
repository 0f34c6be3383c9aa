"""Firmware of the Dynamixel X series: modes, profiles, units (e-manual, sections 2.4.1 ff.)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

from servosim.drive import Mode
from servosim.motor import Motor
from servosim.servo import Protocol, Refusal, Servo
from servosim.servos.dynamixel_x_backup import Backup
from servosim.servos.dynamixel_x_rules import Rules
from servosim.servos.dynamixel_x_watch import Watch
from servosim.shaft import Shaft
from servosim.tables import ServoTable

__all__ = ["DynamixelX"]

BAUDS = (9600, 57600, 115200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)
VELOCITY_RAD_S = 0.229 * 2.0 * math.pi / 60.0
ACCELERATION_RAD_S2 = 214.577 * 2.0 * math.pi / 3600.0
PWM_FULL = 885  # 0.113 % each
TICKS_PER_RAD = 4096 / (2.0 * math.pi)
CONTROL_HZ = 1000.0  # rate of the position loop that the I and D gains refer to

MODES = {
    0: Mode.CURRENT,
    1: Mode.VELOCITY,
    3: Mode.POSITION,
    4: Mode.POSITION,
    5: Mode.CURRENT_POSITION,
    16: Mode.PWM,
}


class DynamixelX(Servo):
    """An X-series servo."""

    protocol = Protocol.DYNAMIXEL_2
    bauds = MappingProxyType(dict(enumerate(BAUDS)))

    def __init__(
        self,
        table: ServoTable,
        motor: Motor,
        shaft: Shaft,
        delivered: Mapping[str, int] | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(table, motor, shaft, delivered, seed)
        self._unmount(delivered or {})
        self.turn_base_tick = 0
        self.mode = 3
        self.rules = Rules(self)
        self.watch = Watch(self)
        self.backup = Backup(self)
        self.current_unit_a = 0.001 if table.model.startswith("XL330") else 0.00269
        self._list_live()
        self._list_effects()
        self.start()

    # The line's questions.

    @property
    def return_delay_s(self) -> float:
        """The return delay register, 2 µs a step."""
        return self.memory.get("return_delay_time") * 2e-6

    @property
    def status_level(self) -> int:
        """The status return level register."""
        return self.memory.get("status_return_level")

    @property
    def secondary_id(self) -> int | None:
        """The secondary id register, when it is in force."""
        second = self.memory.get("secondary_id")
        return second if second <= 252 and second != self.id else None

    @property
    def alarm(self) -> int:
        """The alarm bits of a status packet."""
        return 0x80 if self.memory.get("hardware_error_status") else 0

    def refusal(self, address: int, data: bytes) -> Refusal | None:
        """Judge a write by the rules of the family."""
        return self.rules.refusal(address, data)

    def read_bytes(self, address: int, length: int) -> bytes:
        """Read, following indirect addresses."""
        return self.rules.read(address, length, super().read_bytes)

    def store(self, address: int, data: bytes) -> None:
        """Store, following indirect addresses."""
        self.rules.store(address, data, super().store)

    def supervise(self, dt_s: float) -> None:
        """Look after heat, load, voltage and the bus."""
        self.watch.look(dt_s)

    # Position.

    @property
    def reversed(self) -> bool:
        """Drive mode bit 0: positions are counted the other way round."""
        return bool(self.memory.get("drive_mode") & 1)

    @property
    def modes(self) -> tuple[int, ...]:
        """Operating modes of this model: those of current need a current sensor."""
        senses_current = "goal_current" in self.table.by_name
        return tuple(MODES) if senses_current else (1, 3, 4, 16)

    @property
    def offset_tick(self) -> int:
        """The homing offset that is in force: position mode ignores more than a quarter turn."""
        offset = self.memory.get("homing_offset")
        return offset if self.mode != 3 or abs(offset) <= 1024 else 0

    def actual_tick(self) -> int:
        """Return the sensor's tick over all turns, in the direction of the drive mode."""
        tick = self.shaft.tick_at(self.motor.encoder_rad)
        return -tick if self.reversed else tick

    def present_tick(self) -> int:
        """Return the present position register's number."""
        return self.actual_tick() - self.turn_base_tick + self.offset_tick

    def angle_at(self, position_tick: int) -> float:
        """Return the joint angle [rad] of a position register's number."""
        tick = position_tick - self.offset_tick + self.turn_base_tick
        return self.shaft.angle_at(-tick if self.reversed else tick)

    def forget_turns(self) -> None:
        """Count the present position from its single turn again."""
        self.turn_base_tick = self.actual_tick() // 4096 * 4096

    @property
    def direction(self) -> int:
        """Sign between registers and the joint's coordinate."""
        return -self.shaft.sign if self.reversed else self.shaft.sign

    # From memory to drive.

    def start(self) -> None:
        """Set everything from the memory after power-up."""
        self.drive.torque_on = False
        self.watch.start()
        self.mode = self.memory.get("operating_mode")
        self.forget_turns()
        self._reset_goals()
        self.drive.mode = MODES.get(self.mode, Mode.POSITION)
        for effect in (self.set_gains, self.set_limits, self.set_goal):
            effect()
        if self.memory.get("startup_configuration") & 2:
            self.backup.restore()
        if self.memory.get("startup_configuration") & 1:
            self.memory.put("torque_enable", 1)
            self.set_torque()

    def set_mode(self) -> None:
        """Operating mode written: gains, profile and goals back to defaults, one turn."""
        mode = self.memory.get("operating_mode")
        if mode == self.mode:
            return
        self.mode = mode
        for name in ("position_p_gain", "position_i_gain", "position_d_gain", "velocity_p_gain",
                     "velocity_i_gain", "feedforward_1st_gain", "feedforward_2nd_gain",
                     "profile_velocity", "profile_acceleration"):  # fmt: skip
            self.memory.put(name, self.table.by_name[name].default)
        self.forget_turns()
        self._reset_goals()
        self.drive.mode = MODES[mode]
        for effect in (self.set_gains, self.set_limits, self.set_goal):
            effect()

    def set_torque(self) -> None:
        """Torque enable written: position mode starts again from one turn."""
        on = bool(self.memory.get("torque_enable"))
        if on and not self.drive.torque_on and self.mode == 3:
            self.forget_turns()
        self.drive.torque_on = on
        if on:
            self.set_goal()

    def set_goal(self) -> None:
        """A goal was written: hand it over with the profile that belongs to it."""
        drive, get = self.drive, self.memory.get
        self.set_profile()
        drive.goal_rad = self.angle_at(get("goal_position"))
        drive.goal_velocity_rad_s = self.direction * get("goal_velocity") * VELOCITY_RAD_S
        goal_pwm = get("goal_pwm") / PWM_FULL
        drive.goal_pwm = self.direction * goal_pwm
        limit = get("pwm_limit") / PWM_FULL
        drive.pwm_limit = limit if self.mode == 16 else min(limit, abs(goal_pwm))
        if "goal_current" in self.table.by_name:
            drive.goal_current_a = self.direction * get("goal_current") * self.current_unit_a

    def set_position_goal(self) -> None:
        """Goal position written; drive mode bit 3 turns the torque on with it."""
        if self.memory.get("drive_mode") & 8 and not self.drive.torque_on:
            self.memory.put("torque_enable", 1)
            self.set_torque()
        self.set_goal()

    def set_profile(self) -> None:
        """Hand the profile registers over, as velocities or as times (drive mode bit 2)."""
        drive, get = self.drive, self.memory.get
        velocity, acceleration = get("profile_velocity"), get("profile_acceleration")
        timed = bool(get("drive_mode") & 4)
        drive.profile_time_s = velocity / 1000.0 if timed else 0.0
        drive.acceleration_time_s = min(acceleration, velocity / 2) / 1000.0 if timed else 0.0
        limit = min(velocity, get("velocity_limit")) or velocity
        drive.velocity_limit_rad_s = 0.0 if timed else limit * VELOCITY_RAD_S
        drive.acceleration_rad_s2 = 0.0 if timed else acceleration * ACCELERATION_RAD_S2

    def set_gains(self) -> None:
        """Hand the gains over in SI: the sheets' outputs are PWM steps, their errors ticks."""
        drive, get = self.drive, self.memory.get
        drive.kp = get("position_p_gain") / 128 * TICKS_PER_RAD / PWM_FULL
        drive.ki = get("position_i_gain") / 65536 * TICKS_PER_RAD * CONTROL_HZ / PWM_FULL
        drive.kd = get("position_d_gain") / 16 * TICKS_PER_RAD / CONTROL_HZ / PWM_FULL
        drive.velocity_kp = get("velocity_p_gain") / 128 / VELOCITY_RAD_S / PWM_FULL
        drive.velocity_ki = get("velocity_i_gain") / 65536 * CONTROL_HZ / VELOCITY_RAD_S / PWM_FULL

    def set_limits(self) -> None:
        """Hand the limits of the EEPROM over."""
        self.drive.moving_threshold_rad_s = self.memory.get("moving_threshold") * VELOCITY_RAD_S
        if "current_limit" in self.table.by_name:
            self.drive.current_limit_a = self.memory.get("current_limit") * self.current_unit_a

    # Tables of what is measured and what is set off.

    def _list_live(self) -> None:
        motor = self.motor
        stall_nm = motor.parameters.stall_torque_nm
        self.live = {
            "present_position": self.present_tick,
            "present_velocity": lambda: self._speed(motor.velocity_rad_s),
            "present_pwm": lambda: round(self.direction * motor.pwm * PWM_FULL),
            "present_current": lambda: round(
                self.direction * motor.current_a / self.current_unit_a
            ),
            "present_load": lambda: round(self.direction * motor.torque_nm / stall_nm * 1000),
            "velocity_trajectory": lambda: self._speed(motor.reference_velocity_rad_s),
            "position_trajectory": self._trajectory_tick,
            "present_input_voltage": lambda: round(self.supply_v * 10),
            "present_temperature": lambda: int(motor.temperature_c),
            "realtime_tick": lambda: int((self.time_s - self.boot_s) * 1000) % 32768,
            "moving": lambda: int(motor.moving),
            "backup_ready": lambda: int(self.backup.ready),
            "moving_status": self.watch.moving_status,
        }

    def _list_effects(self) -> None:
        self.effects = {
            "operating_mode": self.set_mode,
            "torque_enable": self.set_torque,
            "goal_position": self.set_position_goal,
            "bus_watchdog": self.watch.start_watchdog,
            **dict.fromkeys(("goal_pwm", "goal_current", "goal_velocity"), self.set_goal),
            **dict.fromkeys(("pwm_limit", "homing_offset", "drive_mode"), self.renew_goals),
            **dict.fromkeys(("moving_threshold", "current_limit"), self.set_limits),
            **dict.fromkeys(
                ("position_p_gain", "position_i_gain", "position_d_gain", "velocity_p_gain",
                 "velocity_i_gain"), self.set_gains),
        }  # fmt: skip

    def _speed(self, velocity_rad_s: float) -> int:
        return round(self.direction * velocity_rad_s / VELOCITY_RAD_S)

    def _trajectory_tick(self) -> int:
        tick = self.shaft.tick_at(self.motor.reference_rad)
        return (-tick if self.reversed else tick) - self.turn_base_tick + self.offset_tick

    def renew_goals(self) -> None:
        """What goals mean has changed: start from where the servo is."""
        self._reset_goals()
        self.set_goal()

    def hold_here(self) -> None:
        """The bus watchdog stops the servo: no motion, no profile."""
        for name in ("profile_velocity", "profile_acceleration", "goal_velocity"):
            self.memory.put(name, 0)
        self.memory.put("goal_position", self.present_tick())
        for mode, name in ((16, "goal_pwm"), (0, "goal_current")):
            if self.mode == mode:
                self.memory.put(name, 0)
        self.set_goal()

    def _reset_goals(self) -> None:
        put, get = self.memory.put, self.memory.get
        put("goal_position", self.present_tick())
        put("goal_velocity", 0)
        put("goal_pwm", get("pwm_limit"))
        if "goal_current" in self.table.by_name:
            put("goal_current", get("current_limit"))

    def _unmount(self, delivered: Mapping[str, int]) -> None:
        """Turn a zero tick given for reported positions into one of the bare sensor."""
        tick = self.shaft.zero_tick - delivered.get("homing_offset", 0)
        if delivered.get("drive_mode", 0) & 1:
            self.shaft = Shaft(-self.shaft.sign, -tick, self.shaft.ticks)
        else:
            self.shaft = Shaft(self.shaft.sign, tick, self.shaft.ticks)
