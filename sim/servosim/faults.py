"""Fault injection: faults of servos, supply, cable and replies, and scripts of them."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Any, Protocol

from servosim.errors import FaultError
from servosim.own_files import parse_json, read_text, read_toml

if TYPE_CHECKING:
    from servosim.servo import Servo
    from servosim.world import World

_INTEGER_KEYS = ("id", "bytes", "bits")
_RANGES = {
    "id": (0, 253),
    "at_s": (-math.inf, math.inf),
    "for_s": (0.0, math.inf),
    "count": (0, math.inf),
    "probability": (0.0, 1.0),
    "delay_s": (0.0, 3600.0),
    "bytes": (0, 4096),
    "bits": (0, 255),
    "volts": (0.0, 60.0),
    "celsius": (-55.0, 300.0),
    "grip": (0.0, 1.0),
}


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault to inject.

    Attributes:
        kind: A key of ``EVENTS`` or ``REPLY_FAULTS``, or ``LOST``.
        id: The servo concerned; None for all.
        at_s: The start of the fault, in seconds of the simulation.
        for_s: The duration of the fault.
        count: Maximum number of occurrences (faults of replies and instructions).
        probability: Probability of each occurrence (faults of replies and instructions).
        delay_s: The delay of a late reply.
        bytes: The length of the garbage, or of the rest of a short reply.
        bits: Bits that are flipped in a reply, or set in an alarm.
        volts: The wrong supply voltage.
        celsius: The temperature of an overheated servo.
        grip: Fraction of the torque that slipping gears transmit.
    """

    kind: str
    id: int | None = None
    at_s: float = 0.0
    for_s: float = math.inf
    count: float = math.inf
    probability: float = 1.0
    delay_s: float = 0.05
    bytes: int = 3
    bits: int = 1
    volts: float = 4.0
    celsius: float = 90.0
    grip: float = 0.2

    def __post_init__(self) -> None:
        for name, (lower, upper) in _RANGES.items():
            value = getattr(self, name)
            if name == "id" and value is None:
                continue
            if name in _INTEGER_KEYS and (isinstance(value, bool) or not isinstance(value, int)):
                raise FaultError(f"{name} = {value!r} is not a whole number")
            if not lower <= value <= upper:
                raise FaultError(f"{name} = {value!r} is not between {lower:g} and {upper:g}")

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> Fault:
        """Return the fault that a table of a file describes.

        Raises:
            FaultError: An unknown key or kind, or a value of the wrong kind.
        """
        known = [field.name for field in fields(cls)]
        for key, value in table.items():
            if key not in known:
                raise FaultError(f"a fault has no key {key!r}; known: {', '.join(known)}")
            if not isinstance(value, str if key == "kind" else (int, float)):
                raise FaultError(f"{key} = {value!r} has the wrong kind")
        if "kind" not in table:
            raise FaultError("a fault needs a kind")
        return cls(**table)


def read_faults(path: Path) -> list[Fault]:
    """Read the faults of a file: TOML with ``[[fault]]`` tables, or JSON with a list.

    Raises:
        FaultError: The file cannot be read, or a fault in it is invalid.
    """
    try:
        is_json = path.suffix == ".json"
        listed = parse_json(read_text(path)) if is_json else read_toml(path)["fault"]
    except KeyError as error:
        raise FaultError(f"{path}: there is no [[fault]] in it") from error
    except (OSError, ValueError) as error:
        raise FaultError(f"{path}: {error}") from error
    try:
        return [Fault.from_table(table) for table in listed]
    except (FaultError, AttributeError, TypeError) as error:
        raise FaultError(f"{path}: {error}") from error


Undo = Callable[[], None]


class FaultyLine(Protocol):
    """A line with faults.

    Attributes:
        plugged: Whether the cable is plugged in.
    """

    plugged: bool

    @property
    def world(self) -> World:
        """The world of the line: servos, supplies and time."""
        ...


def _no_undo() -> None:
    """Do nothing, because there is nothing to end."""


def _affected_servos(line: FaultyLine, fault: Fault) -> list[Servo]:
    return [servo for servo in line.world.servos if fault.id in (None, servo.id)]


def _unplug_cable(line: FaultyLine, _: Fault) -> Undo:
    line.plugged = False

    def replug() -> None:
        line.plugged = True

    return replug


def _apply_brownout(line: FaultyLine, fault: Fault) -> Undo:
    servos = _affected_servos(line, fault)
    for servo in servos:
        servo.power_down()

    def power_up() -> None:
        for servo in servos:
            servo.power_up()

    return power_up


def _reset_servos(line: FaultyLine, fault: Fault) -> Undo:
    for servo in _affected_servos(line, fault):
        servo.reboot()
    return _no_undo


def _raise_alarm(line: FaultyLine, fault: Fault) -> Undo:
    servos = _affected_servos(line, fault)
    for servo in servos:
        servo.inject_alarm(fault.bits)

    def clear() -> None:
        for servo in servos:
            servo.inject_alarm(0)

    return clear


def _overheat_servo(line: FaultyLine, fault: Fault) -> Undo:
    for servo in _affected_servos(line, fault):
        servo.motor.heat.temperature_c = fault.celsius
    return _no_undo


def _block_joint(line: FaultyLine, fault: Fault) -> Undo:
    servos = _affected_servos(line, fault)
    for servo in servos:
        servo.motor.stuck = True

    def free() -> None:
        for servo in servos:
            servo.motor.stuck = False
        line.world.leave_idle()

    return free


def _slip_joint(line: FaultyLine, fault: Fault) -> Undo:
    servos = _affected_servos(line, fault)
    for servo in servos:
        servo.motor.grip = fault.grip

    def mend() -> None:
        for servo in servos:
            servo.motor.grip = 1.0
        line.world.leave_idle()

    return mend


def _change_voltage(line: FaultyLine, fault: Fault) -> Undo:
    rails = line.world.supplies_of(_affected_servos(line, fault))
    before = [rail.open_v for rail in rails]
    for rail in rails:
        rail.open_v = fault.volts

    def mend() -> None:
        for rail, volts in zip(rails, before, strict=True):
            rail.open_v = volts
        line.world.leave_idle()

    return mend


def _drop_torque(line: FaultyLine, fault: Fault) -> Undo:
    for servo in _affected_servos(line, fault):
        servo.cut_torque()
    return _no_undo


EVENTS: dict[str, Callable[[FaultyLine, Fault], Undo]] = {
    "unplug": _unplug_cable,  # the cable is pulled; plugged in again at the end
    "brownout": _apply_brownout,  # no supply and no torque; the servos boot at the end
    "reset": _reset_servos,  # the firmware restarts in mid-motion
    "alarm": _raise_alarm,  # `bits` of the error byte
    "hot": _overheat_servo,  # the servo is at `celsius`, and cools from there
    "stuck": _block_joint,  # the shaft does not move
    "slipping": _slip_joint,  # the gears transmit `grip` of the torque
    "voltage": _change_voltage,  # the supply gives `volts`
    "torque_lost": _drop_torque,  # the bridge is off although the register says on
}


Arrival = tuple[float, bytes]  # delay after the due time [s], bytes

LOST = "lost"  # the host's instruction is not received


def _drop_reply(_: bytes, __: Fault, ___: Random) -> list[Arrival]:
    return []


def _delay_reply(data: bytes, fault: Fault, _: Random) -> list[Arrival]:
    return [(fault.delay_s, data)]


def _shorten_reply(data: bytes, fault: Fault, _: Random) -> list[Arrival]:
    return [(0.0, data[: fault.bytes])]


def _flip_bits(data: bytes, fault: Fault, random: Random) -> list[Arrival]:
    flipped = int.from_bytes(data, "little")
    for bit in random.sample(range(8 * len(data)), min(fault.bits, 8 * len(data))):
        flipped ^= 1 << bit
    return [(0.0, flipped.to_bytes(len(data), "little"))]


def _corrupt_checksum(data: bytes, _: Fault, __: Random) -> list[Arrival]:
    return [(0.0, data[:-1] + bytes((data[-1] ^ 0xFF,)))]


def _insert_garbage(data: bytes, fault: Fault, random: Random) -> list[Arrival]:
    return [(0.0, random.randbytes(fault.bytes) + data)]


def _truncate_reply(data: bytes, _: Fault, random: Random) -> list[Arrival]:
    return [(0.0, data[: random.randrange(len(data))])]


def _duplicate_reply(data: bytes, fault: Fault, _: Random) -> list[Arrival]:
    return [(0.0, data), (fault.delay_s, data)]


REPLY_FAULTS: dict[str, Callable[[bytes, Fault, Random], list[Arrival]]] = {
    "silent": _drop_reply,  # no reply at all
    "late": _delay_reply,  # late by delay_s, so that it meets the next request
    "short": _shorten_reply,  # only the first `bytes`
    "flipped": _flip_bits,  # `bits` flipped bits, anywhere
    "checksum": _corrupt_checksum,  # the last byte is wrong
    "garbage": _insert_garbage,  # `bytes` of garbage before the header
    "truncated": _truncate_reply,  # ends at a random byte
    "duplicated": _duplicate_reply,  # sent again after delay_s
}


@dataclass(slots=True)
class _ActiveFault:
    """A fault of replies or instructions, and the number of times that it was applied."""

    fault: Fault
    strikes: int = 0

    def is_triggered(self, at_s: float, chance: random.Random) -> bool:
        fault = self.fault
        inside = fault.at_s <= at_s < fault.at_s + fault.for_s and self.strikes < fault.count
        if not inside or (fault.probability < 1.0 and chance.random() >= fault.probability):
            return False
        self.strikes += 1
        return True


class FaultScript:
    """All faults of one line; the same seed gives the same faults."""

    def __init__(self, line: FaultyLine, seed: int) -> None:
        self._line = line
        self._random = random.Random(seed)  # noqa: S311 - chance of faults
        self._replies: list[_ActiveFault] = []
        self._lost: list[_ActiveFault] = []

    def add(self, fault: Fault) -> None:
        """Schedule a fault at its time, or now if that has passed.

        Raises:
            FaultError: There is no such kind of fault.
        """
        if fault.kind in REPLY_FAULTS:
            self._replies.append(_ActiveFault(fault))
        elif fault.kind == LOST:
            self._lost.append(_ActiveFault(fault))
        elif fault.kind in EVENTS:
            self._line.world.schedule(fault.at_s, lambda: self._start_fault(fault))
        else:
            known = ", ".join((*REPLY_FAULTS, LOST, *EVENTS))
            raise FaultError(f"no fault is named {fault.kind!r}; known: {known}")

    def clear(self) -> None:
        """Remove the faults of replies and instructions."""
        self._replies.clear()
        self._lost.clear()

    def loses_instruction(self, at_s: float) -> bool:
        """Check whether an instruction is not received."""
        if not self._lost:  # called for each frame on the line
            return False
        return any(running.is_triggered(at_s, self._random) for running in self._lost)

    @property
    def changes_replies(self) -> bool:
        """Whether a fault of replies is active."""
        return bool(self._replies)

    def faulty_arrivals(self, servo: Servo | None, at_s: float, data: bytes) -> list[Arrival]:
        """Return the parts of a reply that reach the host: delays and bytes."""
        arrivals: list[Arrival] = [(0.0, data)]
        for running in self._replies:
            concerns = servo is not None and running.fault.id in (None, servo.id)
            if concerns and data and running.is_triggered(at_s, self._random):
                arrivals = [
                    (delay_s + more_s, altered)
                    for delay_s, piece in arrivals
                    for more_s, altered in REPLY_FAULTS[running.fault.kind](
                        piece, running.fault, self._random
                    )
                ]
        return arrivals

    def _start_fault(self, fault: Fault) -> None:
        end = EVENTS[fault.kind](self._line, fault)
        world = self._line.world
        world.leave_idle()
        world.schedule(world.time_s + fault.for_s, end)
