"""Firmware of the Dynamixel X series: modes, profiles, units (e-manual, sections 2.4.1 ff.)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from servosim.drive import Mode
from servosim.motor import Motor
from servosim.protocol import Protocol, Refusal
from servosim.servo import Servo
from servosim.servos.dynamixel_x_backup import Backup
from servosim.servos.dynamixel_x_orders import Orders
from servosim.servos.dynamixel_x_registers import measured, set_off
from servosim.servos.dynamixel_x_rules import Rules
from servosim.servos.dynamixel_x_watch import Watch
from servosim.shaft import Shaft
from servosim.tables import ServoTable

__all__ = ["DynamixelX"]

BAUDS = (9600, 57600, 115200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)
PROTOCOL_1_ALARMS = 0x25  # voltage, heat and overload have the same bits in both protocols

ASKED_EACH_TIME = (  # registers of one byte that each frame on the line is judged by
    "secondary_id", "return_delay_time", "status_return_level", "hardware_error_status",
)  # fmt: skip
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

    instructions = frozenset((1, 2, 3, 4, 5, 6, 8, 0x83, 0x92))
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
        self._second_at, self._delay_at, self._level_at, self._error_at = (
            table.by_name[name].address for name in ASKED_EACH_TIME
        )
        self.turn_base_tick = 0
        self.mode = 3
        self.reversed = False
        self.rules = Rules(self)
        self.watch = Watch(self)
        self.backup = Backup(self)
        self.orders = Orders(self)
        self.live = measured(self)
        self.effects = set_off(self)
        self.start()

    # The line's questions.

    @property
    def return_delay_s(self) -> float:
        """The return delay register, 2 µs a step."""
        return self.memory.image[self._delay_at] * 2e-6

    @property
    def status_level(self) -> int:
        """The status return level register."""
        return self.memory.image[self._level_at]

    @property
    def secondary_id(self) -> int | None:
        """The secondary id register, when it is in force."""
        second = self.memory.image[self._second_at]
        return second if second <= 252 and second != self.id else None

    @property
    def alarm(self) -> int:
        """The alarm bits of a status packet: protocol 2.0 has one for all causes."""
        bits = self.memory.image[self._error_at]
        return bits & PROTOCOL_1_ALARMS if self.protocol is Protocol.DYNAMIXEL_1 else bits and 0x80

    def refusal(self, address: int, data: bytes) -> Refusal | None:
        """Judge a write by the rules of the family."""
        return self.rules.refusal(address, data)

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

    def supervise(self, dt_s: float) -> None:
        """Look after heat, load, voltage and the bus."""
        self.watch.look(dt_s)

    def inject_alarm(self, bits: int) -> None:
        """Raise hardware error bits; only a reboot takes them back."""
        if bits:
            self.watch.raise_alarm(bits)

    def allows(self, goal: int) -> bool:
        """Say whether a goal position lies inside the limits of position mode."""
        if self.mode != 3:
            return True
        return (
            self.memory.get("min_position_limit") <= goal <= self.memory.get("max_position_limit")
        )

    # Position.

    @property
    def modes(self) -> tuple[int, ...]:
        """Operating modes of this model: those of current need a current sensor."""
        return tuple(MODES) if self.orders.senses_current else (1, 3, 4, 16)

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

    def set_protocol(self) -> None:
        """Protocol type written: 1 speaks protocol 1.0."""
        old = self.memory.get("protocol_type") == 1
        self.protocol = Protocol.DYNAMIXEL_1 if old else Protocol.DYNAMIXEL_2
        self.framing = self.protocol.framing

    def start(self) -> None:
        """Set everything from the memory after power-up."""
        self.set_protocol()
        self.reversed = bool(self.memory.get("drive_mode") & 1)
        self.drive.torque_on = False
        self.watch.start()
        self.mode = self.memory.get("operating_mode")
        self.forget_turns()
        self._reset_goals()
        self.drive.mode = MODES.get(self.mode, Mode.POSITION)
        for effect in (self.orders.set_gains, self.orders.set_limits, self.orders.set_goal):
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
        for effect in (self.orders.set_gains, self.orders.set_limits, self.orders.set_goal):
            effect()

    def set_drive_mode(self) -> None:
        """Drive mode written: bit 0 counts positions the other way round."""
        self.reversed = bool(self.memory.get("drive_mode") & 1)
        self.renew_goals()

    def set_torque(self) -> None:
        """Torque enable written: position mode starts again from one turn."""
        on = bool(self.memory.get("torque_enable"))
        if on and not self.drive.torque_on and self.mode == 3:
            self.forget_turns()
        self.drive.torque_on = on
        if on:
            self.orders.set_goal()

    def set_position_goal(self) -> None:
        """Goal position written; drive mode bit 3 turns the torque on with it."""
        if self.memory.get("drive_mode") & 8 and not self.drive.torque_on:
            self.memory.put("torque_enable", 1)
            self.set_torque()
        self.orders.set_position_goal()

    def trajectory_tick(self) -> int:
        """Return the position trajectory register's number."""
        tick = self.shaft.tick_at(self.motor.reference_rad)
        return (-tick if self.reversed else tick) - self.turn_base_tick + self.offset_tick

    def renew_goals(self) -> None:
        """What goals mean has changed: start from where the servo is."""
        self._reset_goals()
        self.orders.set_goal()

    def hold_here(self) -> None:
        """The bus watchdog stops the servo: no motion, no profile."""
        for name in ("profile_velocity", "profile_acceleration", "goal_velocity"):
            self.memory.put(name, 0)
        self.orders.note_profile()
        self.memory.put("goal_position", self.present_tick())
        for mode, name in ((16, "goal_pwm"), (0, "goal_current")):
            if self.mode == mode:
                self.memory.put(name, 0)
        self.orders.set_goal()
        self.changed()

    def _reset_goals(self) -> None:
        self.orders.note_profile()
        put, get = self.memory.put, self.memory.get
        put("goal_position", self.present_tick())
        put("goal_velocity", 0)
        put("goal_pwm", get("pwm_limit"))
        if self.orders.senses_current:
            put("goal_current", get("current_limit"))

    def _unmount(self, delivered: Mapping[str, int]) -> None:
        """Turn a zero tick given for reported positions into one of the bare sensor."""
        tick = self.shaft.zero_tick - delivered.get("homing_offset", 0)
        if delivered.get("drive_mode", 0) & 1:
            self.shaft = Shaft(-self.shaft.sign, -tick, self.shaft.ticks)
        else:
            self.shaft = Shaft(self.shaft.sign, tick, self.shaft.ticks)
