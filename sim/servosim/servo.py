"""A servo: memory, firmware and motor; what all families have in common."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping

from servosim.drive import Drive
from servosim.frames import Dynamixel2Reader, FrameReader
from servosim.memory import Memory
from servosim.motor import Motor
from servosim.protocol import Protocol, Refusal
from servosim.shaft import Shaft
from servosim.tables import Register, ServoTable

__all__ = ["Servo"]


_Live = tuple[int, int, Register, Callable[[], int]]


class Servo:
    """A servo on the line: its memory is all that instructions can see of it.

    The families fill ``live`` (registers that the firmware measures, by name) and ``effects``
    (what a write to a register sets off), and answer ``refusal`` for their access rules.

    Attributes:
        memory: The control table's bytes.
        motor: The physics behind it.
        drive: What the firmware asks of the motor.
        shaft: How the sensor sits on the joint.
        supply_v: Voltage at its plug.
        time_s: The simulated time that the firmware has seen.
        deaf_until_s: While booting a servo neither hears nor answers.
        heard_s: When the last instruction packet came by.
        pending: A registered write that waits for its action.
        changed: Called when an instruction or a script has changed something.
        asked: Told of every write before it is judged.
    """

    reboot_s = 0.3  # assumed; the sheets give none
    protocol = Protocol.DYNAMIXEL_2
    framing: type[FrameReader] = Dynamixel2Reader
    bauds: Mapping[int, float] = {}  # rate by number of the baud register
    registered_flag = "registered_instruction"
    instructions: frozenset[int] = frozenset()  # those of protocol 1 framing that it knows
    answers_broadcast_ping = False
    kept_by_recovery: tuple[str, ...] = ()

    def __init__(
        self,
        table: ServoTable,
        motor: Motor,
        shaft: Shaft,
        delivered: Mapping[str, int] | None = None,
        seed: int = 0,
    ) -> None:
        self.table, self.motor, self.shaft = table, motor, shaft
        self.drive = Drive()
        self.memory = Memory(table, delivered)
        self._id_at = table.by_name["id"].address
        self._baud_at = table.by_name["baud_rate"].address
        self.supply_v = motor.parameters.nominal_v
        self.time_s = self.boot_s = self.heard_s = 0.0
        self.deaf_until_s = 0.0
        self.powered = True
        self.pending: tuple[int, bytes] | None = None
        self.random = random.Random(seed)  # noqa: S311 - a crystal's tolerance, not a secret
        self.live: dict[str, Callable[[], int]] = {}
        self.effects: dict[str, Callable[[], None]] = {}
        self.changed: Callable[[], None] = _nothing
        self.asked: Callable[[int, bytes], None] | None = None
        self._plans: dict[tuple[int, int], tuple[_Live, ...]] = {}
        self._effects: dict[tuple[int, int], tuple[Callable[[], None], ...]] = {}

    # What the line needs to know, kept at hand because every frame asks for it.

    @property
    def id(self) -> int:
        """The id it answers to."""
        return self.memory.image[self._id_at]

    @property
    def baud(self) -> int:
        """The rate that the baud register names."""
        return round(self.bauds.get(self.memory.image[self._baud_at], 0.0))

    @property
    def return_delay_s(self) -> float:
        """Time between an instruction's last byte and the first of its status."""
        raise NotImplementedError

    @property
    def status_level(self) -> int:
        """Which instructions are answered: 0 ping only, 1 also reads, 2 all."""
        raise NotImplementedError

    @property
    def secondary_id(self) -> int | None:
        """A second id whose instructions are obeyed without an answer."""
        return None

    @property
    def alarm(self) -> int:
        """The alarm bits of the status packet's error byte."""
        raise NotImplementedError

    # Memory as instructions see it.

    def read_bytes(self, address: int, length: int) -> bytes:
        """Return bytes of the memory, measured registers fresh."""
        plan = self._plans.get((address, length))
        if plan is None:
            plan = self._plans[address, length] = self._plan(address, length)
        image = self.memory.image
        for start, end, row, measure in plan:
            image[start:end] = row.encode(measure())
        return self.memory.read(address, length)

    def write_bytes(self, address: int, data: bytes) -> Refusal | None:
        """Do what a write instruction asks, or say why not; a refused write changes nothing."""
        if self.asked is not None:
            self.asked(address, data)
        refusal = self.refusal(address, data)
        if refusal is None:
            self.store(address, data)
        return refusal

    def refusal(self, address: int, data: bytes) -> Refusal | None:
        """Say why a write is not allowed, or None."""
        raise NotImplementedError

    def store(self, address: int, data: bytes) -> None:
        """Write without asking and set off what the registers set off."""
        self.memory.write(address, data, persist=self.eeprom_open)
        self.set_off(address, len(data))

    def set_off(self, address: int, length: int) -> None:
        """Run what a write to these addresses sets off, each effect once."""
        effects = self._effects.get((address, length))
        if effects is None:
            rows = [row for row in self.table.covered(address, length) if row.writable]
            found = [self.effects[row.name] for row in rows if row.name in self.effects]
            effects = self._effects[address, length] = tuple(dict.fromkeys(found))
        for effect in effects:
            effect()
        self.changed()

    def register(self, address: int, data: bytes) -> Refusal | None:
        """Keep a write until its action comes."""
        refusal = self.refusal(address, data)
        if refusal is None:
            self.pending = (address, data)
            self.memory.put(self.registered_flag, 1)
        return refusal

    def act(self) -> Refusal | None:
        """Do the registered write."""
        if self.pending is None:
            return Refusal.INSTRUCTION
        (address, data), self.pending = self.pending, None
        self.memory.put(self.registered_flag, 0)
        return self.write_bytes(address, data)

    def factory_reset(self, keep: tuple[str, ...]) -> None:
        """Set the memory back to the datasheet's defaults and start anew."""
        self.memory.restore_factory(keep)
        self.reboot()

    def calibrate(self) -> None:
        """Make the present position the middle of the range; most families cannot."""

    def forget_turns(self) -> None:
        """Count turns from the present one again."""

    @property
    def eeprom_open(self) -> bool:
        """Whether writes to EEPROM registers survive the power."""
        return True

    # Memory as tests and scripts see it.

    def read(self, name: str) -> int:
        """Return a register's number as a read instruction would spell it."""
        row = self.table.by_name[name]
        return row.decode(self.read_bytes(row.address, row.size))

    def write(self, name: str, value: int) -> Refusal | None:
        """Write a register as a write instruction would."""
        row = self.table.by_name[name]
        return self.write_bytes(row.address, row.encode(value))

    # Time and power.

    def step(self, dt_s: float, load_nm: float) -> None:
        """Let the motor turn for ``dt_s`` seconds under an outer torque."""
        self.time_s += dt_s
        self.motor.step(dt_s, load_nm, self.drive, self.supply_v)

    @property
    def restless(self) -> bool:
        """Whether a resting shaft may start by itself: profile running or integral growing."""
        return self.drive.torque_on and (self.motor.profile_running or self.drive.ki > 0.0)

    def warm(self, dt_s: float) -> None:
        """Let the winding heat the servo while nothing turns."""
        motor = self.motor
        watts = motor.current_a**2 * motor.parameters.resistance_ohm
        motor.heat.step(dt_s, watts)

    def supervise(self, dt_s: float) -> None:
        """What the firmware watches every few milliseconds: heat, load, voltage, watchdog."""
        raise NotImplementedError

    def reboot(self) -> None:
        """Start the firmware anew: RAM to defaults, torque off, deaf for a while."""
        self.deaf_until_s = self.time_s + self.reboot_s
        self.power_up()

    def power_up(self) -> None:
        """What the firmware does when the power comes."""
        self.powered = True
        self.boot_s = self.time_s
        self.pending = None
        self.memory.power_cycle()
        self.start()
        self.changed()

    def power_down(self) -> None:
        """The supply is gone: deaf and limp."""
        self.powered = False
        self.lose_torque()

    def lose_torque(self) -> None:
        """The bridge goes off, whatever the memory says."""
        self.drive.torque_on = False
        self.changed()

    def inject_alarm(self, bits: int) -> None:
        """Raise alarm bits without a cause; 0 takes them back where the family allows it."""
        raise NotImplementedError

    def allows(self, goal: int) -> bool:
        """Say whether a goal position lies inside the limits of the memory."""
        raise NotImplementedError

    def start(self) -> None:
        """Set the drive from the memory; the families add their own."""
        raise NotImplementedError

    def hears(self, baud: int, now_s: float) -> bool:
        """Say whether bytes at ``baud`` reach the firmware: within 3 % of its own rate, awake."""
        if not self.powered or now_s < self.deaf_until_s:
            return False
        own = self.bauds.get(self.memory.image[self._baud_at], 0.0)
        return abs(own - baud) <= 0.03 * baud

    def _plan(self, address: int, length: int) -> tuple[_Live, ...]:
        rows = self.table.covered(address, length)
        return tuple(
            (row.address, row.end, row, self.live[row.name])
            for row in rows
            if row.name in self.live
        )


def _nothing() -> None:
    """Nobody wants to know."""
