"""A servo: memory, firmware, motor, horn mounting; common to all families."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum

from servosim.control import DriveCommand
from servosim.frames import Dynamixel1Reader, Dynamixel2Reader, FrameReader
from servosim.motor import Motor
from servosim.register import Memory, ServoTable, SimulatedRegister

TURN_RAD = 2.0 * math.pi


class BusProtocol(Enum):
    """Protocol of a servo; two of the protocols have the same framing."""

    DYNAMIXEL_1 = "dynamixel 1.0"
    DYNAMIXEL_2 = "dynamixel 2.0"
    FEETECH = "feetech"

    __hash__ = object.__hash__  # used for every frame; an Enum's own is slow

    @property
    def framing(self) -> type[FrameReader]:
        """The reader class of its frames."""
        return Dynamixel2Reader if self is BusProtocol.DYNAMIXEL_2 else Dynamixel1Reader


class InstructionError(Enum):
    """Reason why a servo refuses an instruction."""

    RESULT_FAIL = "result fail"
    INSTRUCTION = "instruction"
    RANGE = "range"
    LENGTH = "length"
    LIMIT = "limit"
    ACCESS = "access"


class AlarmBits:
    """The alarm byte of one servo, for families whose bits clear with their cause.

    Attributes:
        bits: The byte.
        injected: Bits that were raised without a cause.
    """

    def __init__(self) -> None:
        self.bits = self.injected = 0

    def inject_alarm(self, bits: int) -> None:
        """Raise alarm bits without a cause, or clear those that were raised without a cause."""
        self.bits = self.bits & ~self.injected | bits
        self.injected = bits

    def set_alarm(self, bit: int, present: bool) -> None:
        """Set or clear a bit according to its cause; injected bits stay set."""
        self.bits = self.bits | bit if present else self.bits & ~bit
        self.bits |= self.injected


@dataclass(slots=True)
class HornMounting:
    """The mounting of a servo, which no register reports.

    Attributes:
        sign: +1 if ticks increase with the joint coordinate, -1 if they decrease.
        zero_tick: Tick of the sensor at joint zero; may be fractional.
        ticks: Ticks of one revolution of the servo's shaft.
        rad_per_tick: Radians of one tick.
    """

    sign: int = 1
    zero_tick: float = 2048.0
    ticks: float = 4096
    rad_per_tick: float = field(init=False)

    def __post_init__(self) -> None:
        self.rad_per_tick = 2.0 * math.pi / self.ticks

    def tick_at(self, angle_rad: float) -> int:
        """Compute the nearest tick, multi-turn."""
        revolutions = angle_rad / TURN_RAD
        return round(self.zero_tick + self.sign * revolutions * self.ticks)

    def angle_at(self, tick: float) -> float:
        """Compute the joint angle [rad] at a multi-turn tick."""
        return self.sign * (tick - self.zero_tick) * self.rad_per_tick


_Live = tuple[SimulatedRegister, Callable[[], int]]


class Servo:
    """A servo on the line; instructions access only its memory.

    The families fill ``live`` (registers that the firmware measures, by name) and ``effects``
    (effects of a write to a register), and define ``check_write`` for their access rules.

    Attributes:
        memory: The control table's bytes.
        motor: The physics behind it.
        drive: The firmware's commands to the motor.
        shaft: The mounting of the sensor on the joint.
        supply_v: Voltage at its plug.
        time_s: The simulated time of the firmware.
        booting_until_s: End of booting, before which the servo neither receives nor replies.
        replying_until_s: End of its reply, before which instructions are lost, if the family
            buffers only one.
        received_s: Time of the last instruction packet.
        pending: A registered write that waits for its action.
        changed: Called when an instruction or a script has changed something.
        on_write: Called with every write before it is checked.
        knows_fast_reads: Whether it replies to the fast reads of protocol 2.0.
        goal_enables_torque: Whether a goal position that is written while torque is off switches it
            on, if the family leaves this open.
    """

    reboot_s = 0.3  # assumed, because the sheets give no value
    protocol = BusProtocol.DYNAMIXEL_2
    framing: type[FrameReader] = Dynamixel2Reader
    bauds: Mapping[int, float] = {}  # rate by number of the baud register
    registered_flag = "registered_instruction"
    instructions: frozenset[int] = frozenset()  # supported instructions with protocol 1 framing
    answers_broadcast_ping = False
    knows_fast_reads = True
    kept_by_recovery: tuple[str, ...] = ()
    goal_enables_torque = False
    hears_while_replying = True

    def __init__(
        self,
        table: ServoTable,
        motor: Motor,
        shaft: HornMounting,
        delivered: Mapping[str, int] | None = None,
        seed: int = 0,
    ) -> None:
        self.table, self.motor, self.shaft = table, motor, shaft
        self.drive = DriveCommand()
        self.memory = Memory(table, delivered)
        self._id_at = table.by_name["id"].address
        self._baud_at = table.by_name["baud_rate"].address
        self.supply_v = motor.parameters.nominal_v
        self.time_s = self.boot_s = self.received_s = 0.0
        self.booting_until_s = self.replying_until_s = 0.0
        self.powered = True
        self.pending: tuple[int, bytes] | None = None
        self.random = random.Random(seed)  # noqa: S311 - a crystal's tolerance, not a secret
        self.live: dict[str, Callable[[], int]] = {}
        self.effects: dict[str, Callable[[], None]] = {}
        self.changed: Callable[[], None] = _no_effect
        self.on_write: Callable[[int, bytes], None] | None = None
        self._plans: dict[tuple[int, int], tuple[_Live, ...]] = {}
        self._effects: dict[tuple[int, int], tuple[Callable[[], None], ...]] = {}

    # Cached values that every frame needs.

    @property
    def id(self) -> int:
        """The bus id of the servo."""
        return self.memory.image[self._id_at]

    @property
    def baud(self) -> int:
        """The rate in the baud register."""
        return round(self.bauds.get(self.memory.image[self._baud_at], 0.0))

    @property
    def return_delay_s(self) -> float:
        """The time from an instruction's last byte to the first byte of its status."""
        raise NotImplementedError

    @property
    def status_level(self) -> int:
        """The instructions with a reply: 0 ping only, 1 also reads, 2 all."""
        raise NotImplementedError

    @property
    def secondary_id(self) -> int | None:
        """A second id whose instructions are executed without a reply."""
        return None

    @property
    def alarm(self) -> int:
        """The alarm bits of the status packet's error byte."""
        raise NotImplementedError

    # Memory as instructions see it.

    def read_bytes(self, address: int, length: int) -> bytes:
        """Read bytes of the memory, with measured registers updated."""
        plan = self._plans.get((address, length))
        if plan is None:
            rows = self.table.registers_in(address, length)
            plan = tuple((row, self.live[row.name]) for row in rows if row.name in self.live)
            self._plans[address, length] = plan
        for row, measure in plan:
            self.memory.put_row(row, measure())
        return self.memory.read(address, length)

    def write_bytes(self, address: int, data: bytes) -> InstructionError | None:
        """Execute a write instruction, or return why it is refused; it then changes nothing."""
        if self.on_write is not None:
            self.on_write(address, data)
        refusal = self.check_write(address, data)
        if refusal is None:
            self.store(address, data)
        return refusal

    def check_write(self, address: int, data: bytes) -> InstructionError | None:
        """Return why a write is not allowed, or None."""
        raise NotImplementedError

    def store(self, address: int, data: bytes) -> None:
        """Write without checks and run the effects of the registers."""
        self.memory.write(address, data, persist=self.is_eeprom_unlocked)
        self.apply_write_effects(address, len(data))

    def apply_write_effects(self, address: int, length: int) -> None:
        """Run the effects of a write to these addresses, each once."""
        effects = self._effects.get((address, length))
        if effects is None:
            rows = [row for row in self.table.registers_in(address, length) if row.writable]
            found = [self.effects[row.name] for row in rows if row.name in self.effects]
            effects = self._effects[address, length] = tuple(dict.fromkeys(found))
        for effect in effects:
            effect()
        self.changed()

    def register_write(self, address: int, data: bytes) -> InstructionError | None:
        """Store a write until the action instruction arrives."""
        refusal = self.check_write(address, data)
        if refusal is None:
            self.pending = (address, data)
            self.memory.put(self.registered_flag, 1)
        return refusal

    def execute_registered(self) -> InstructionError | None:
        """Execute the registered write."""
        if self.pending is None:
            return InstructionError.INSTRUCTION
        (address, data), self.pending = self.pending, None
        self.memory.put(self.registered_flag, 0)
        return self.write_bytes(address, data)

    def factory_reset(self, keep: tuple[str, ...]) -> None:
        """Reset the memory to the datasheet's defaults and restart."""
        self.memory.restore_factory(keep)
        self.reboot()

    def calibrate(self, position_tick: int = 2048) -> None:
        """Make the present position the given number, if the family supports it."""

    def reset_turns(self) -> None:
        """Reduce the position to a single revolution."""

    @property
    def is_eeprom_unlocked(self) -> bool:
        """Whether writes to EEPROM registers survive loss of power."""
        return True

    # Memory as tests and scripts see it.

    def read(self, name: str) -> int:
        """Read the value of a register as a read instruction would return it."""
        row = self.table.by_name[name]
        return row.decode(self.read_bytes(row.address, row.size))

    def write(self, name: str, value: int) -> InstructionError | None:
        """Write a register as a write instruction would."""
        row = self.table.by_name[name]
        return self.write_bytes(row.address, row.encode(value))

    # Time and power.

    def step(self, dt_s: float, load_nm: float) -> None:
        """Advance the motor by ``dt_s`` seconds under an external torque."""
        self.time_s += dt_s
        self.motor.step(dt_s, load_nm, self.drive, self.supply_v)

    def press(self, dt_s: float) -> float:
        """Begin a step: run the firmware's controller; return the torque that reaches the shaft."""
        self.time_s += dt_s
        return self.motor.press(dt_s, self.drive, self.supply_v)

    @property
    def is_active(self) -> bool:
        """Whether a resting shaft may start by itself: profile running or integral growing."""
        return self.drive.torque_on and (self.motor.profile_running or self.drive.ki > 0.0)

    def advance_heating(self, dt_s: float) -> None:
        """Advance the thermal model while nothing moves."""
        motor = self.motor
        watts = motor.current_a**2 * motor.parameters.resistance_ohm
        motor.heat.step(dt_s, watts)

    def run_protections(self, dt_s: float) -> None:
        """Run the periodic checks of the firmware: temperature, load, voltage, watchdog."""
        raise NotImplementedError

    def reboot(self) -> None:
        """Restart the firmware: RAM to defaults, torque off, unresponsive for a while."""
        self.booting_until_s = self.time_s + self.reboot_s
        self.power_up()

    def power_up(self) -> None:
        """Start the firmware at power-up."""
        self.powered = True
        self.boot_s = self.time_s
        self.pending = None
        self.memory.power_cycle()
        self.start()
        self.changed()

    def power_down(self) -> None:
        """Switch the supply off: the servo does not respond and its torque is off."""
        self.powered = False
        self.cut_torque()

    def cut_torque(self) -> None:
        """Open the bridge, whatever the memory contains."""
        self.drive.torque_on = False
        self.changed()

    def inject_alarm(self, bits: int) -> None:
        """Raise alarm bits without a cause; 0 clears them if the family allows it."""
        raise NotImplementedError

    def is_goal_allowed(self, goal: int) -> bool:
        """Check whether a goal position is inside the limits of the memory."""
        raise NotImplementedError

    def start(self) -> None:
        """Set the drive from the memory; each family overrides this."""
        raise NotImplementedError

    def is_listening(self, baud: int, now_s: float) -> bool:
        """Check whether bytes at ``baud`` reach the firmware: within 3 % of its rate, booted."""
        if not self.powered or now_s < self.booting_until_s or now_s < self.replying_until_s:
            return False
        own = self.bauds.get(self.memory.image[self._baud_at], 0.0)
        return abs(own - baud) <= 0.03 * baud


def _no_effect() -> None:
    """Do nothing."""
