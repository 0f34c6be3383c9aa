"""Group register accesses into as few sync and bulk reads and writes as possible."""

from __future__ import annotations

import operator
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from math import isfinite
from struct import Struct
from typing import Any

from ikservo.errors import BadValueError, RegisterAccessError, UnknownNameError
from ikservo.hardware.packets import MemoryRange, Reply
from ikservo.hardware.protocols.driver import ProtocolDriver
from ikservo.hardware.servo import ServoSpec
from ikservo.registers import Access, Area, Family, Register, RegisterName, TwosComplement, Unsigned

MAX_GAP_BYTES = 8
"""Number of unused bytes that take no longer to read than a second request to six servos."""


def contiguous_runs(registers: Iterable[Register], gap: int = 0) -> list[list[Register]]:
    """Group the registers into runs that one read can cover.

    Args:
        registers: The registers of one servo.
        gap: Maximum number of unused bytes between two registers of a run. Across unused bytes,
            static registers are not combined with others: they are read twice on a bad line.
    """
    rows = list(registers)
    if len(rows) == 1:
        return [rows]
    runs: list[list[Register]] = []
    for register in sorted(set(rows), key=lambda r: r.address):
        if runs and _extends_run(runs[-1][-1], register, gap):
            runs[-1].append(register)
        else:
            runs.append([register])
    return runs


def _extends_run(last: Register, register: Register, gap: int) -> bool:
    between = register.address - last.end
    return between == 0 or (0 < between <= gap and last.steady is register.steady)


def batches(
    own: Mapping[int, Collection[Register]], gap: int = 0
) -> Iterator[dict[int, list[Register]]]:
    """Yield, for each request, the run of registers of each servo; see ``contiguous_runs``."""
    runs = {servo_id: contiguous_runs(registers, gap) for servo_id, registers in own.items()}
    for k in range(max((len(r) for r in runs.values()), default=0)):
        yield {servo_id: r[k] for servo_id, r in runs.items() if k < len(r)}


RegisterRef = Register | RegisterName
"""A register of any table, or a name that every table has."""


def resolve_register(servo: ServoSpec, ref: RegisterRef) -> Register:
    """Find a register in the register table of a servo.

    Raises:
        UnknownNameError: The servo has no register of that name.
    """
    try:
        return servo.table.find(ref)
    except UnknownNameError as error:
        error.add_note(f"while talking to {servo}")
        raise


def encode_value(servo: ServoSpec, register: Register, value: float, *, raw: bool) -> bytes:
    """Encode the bytes that write a value in the register's unit, or its ``raw`` integer.

    Raises:
        RegisterAccessError: The register is read-only or the value does not fit.
    """
    if register.access is Access.RO:
        raise RegisterAccessError(str(servo), register.name, "it is read-only")
    if raw:
        try:
            number = operator.index(value)  # pyright: ignore[reportArgumentType] (checked here)
        except TypeError:
            message = f"The raw {register} of {servo}"
            raise BadValueError(message, value, "an integer") from None
    elif isfinite(value):
        number = register.to_raw(value)
    else:
        raise RegisterAccessError(str(servo), register.name, f"{value} is not a number")
    lower, upper = register.range
    if not lower <= number <= upper:
        raise RegisterAccessError(
            str(servo), register.name, f"{number} is outside {lower} to {upper}"
        )
    return register.encode(number)


_LETTERS = {1: "B", 2: "H", 4: "I"}


class ReplyLayout:
    """Positions of one servo's registers in the bytes of one reply.

    Args:
        servo: The servo.
        refs: The servo's register for each key of the caller.
        run: Registers in one reply, by address; the first at its beginning, the last at its end.

    Attributes:
        registers: The register of each key.
        state_registers: The registers that contain torque state or alarms.
    """

    def __init__(
        self, servo: ServoSpec, refs: Mapping[RegisterRef, Register], run: Sequence[Register]
    ) -> None:
        self.registers = {key: register for key, register in refs.items() if register in run}
        self.state_registers = {k: r for k, r in self.registers.items() if tracks_state(servo, r)}
        self._places = [(key, run.index(register)) for key, register in self.registers.items()]
        self._unpack = Struct(_struct_format(run)).unpack
        self._coded = [  # the sizes that ``struct`` does not support
            (at, register)
            for at, register in enumerate(run)
            if not isinstance(register.codec, Unsigned | TwosComplement)
        ]

    def decode_raw(self, block: bytes) -> dict[Any, int]:
        """Decode the raw number of each key in a reply."""
        numbers = list(self._unpack(block))
        for at, register in self._coded:
            numbers[at] = register.codec.to_number(numbers[at], register.size)
        return {key: numbers[at] for key, at in self._places}


def tracks_state(servo: ServoSpec, register: Register) -> bool:
    """Check whether a register contains torque state or alarms."""
    table = servo.table
    if register is table.torque_enable:
        return True
    return RegisterName.ALARMS not in table.missing and register is table.alarms


def is_goal(servo: ServoSpec, register: Register) -> bool:
    """Check whether a register is the goal position, which can switch torque on."""
    return register is servo.table.goal_position


def _struct_format(run: Sequence[Register]) -> str:
    """Return the ``struct`` format of registers; the bytes between the registers are skipped."""
    at, letters = run[0].address, ">" if run[0].byte_order == "big" else "<"
    for register in run:
        letter = _LETTERS[register.size]
        signed = isinstance(register.codec, TwosComplement)
        letters += f"{register.address - at}x{letter.lower() if signed else letter}"
        at = register.end
    return letters


@dataclass(frozen=True, slots=True)
class ReadBatch:
    """The data that one request per family can read.

    Attributes:
        servos: The servos to read.
        spans: The memory range, by id.
        layouts: The layout of the reply, by id.
        description: Text for error messages.
        is_static: Whether no value in the data changes by itself.
        groups: The spans of each family, which has its own request.
    """

    servos: Sequence[ServoSpec]
    spans: Mapping[int, MemoryRange]
    layouts: Mapping[int, ReplyLayout]
    description: str
    is_static: bool
    groups: Mapping[Family, Mapping[int, MemoryRange]]

    def restricted_to(self, servos: Sequence[ServoSpec]) -> ReadBatch:
        """Return the same batch for some of the servos."""
        groups = _group_by_family(servos, self.spans)
        return ReadBatch(servos, self.spans, self.layouts, self.description, self.is_static, groups)


@dataclass(frozen=True, slots=True)
class ReadPlan:
    """All batches for one group read, and the servos in it."""

    servo_ids: Sequence[int]
    batches: Sequence[ReadBatch]


@dataclass(frozen=True, slots=True)
class WriteTarget:
    """The register of one servo in a group write.

    Attributes:
        place: The family, the address and the size of the register.
        tracks_state: See ``tracks_state``.
        plain: Whether any integer in its range may be written at any time; False for goals.
    """

    servo: ServoSpec
    register: Register
    place: tuple[Family, int, int]
    tracks_state: bool
    plain: bool


def plan_writes(servos: Iterable[ServoSpec], ref: RegisterRef) -> list[WriteTarget]:
    """Find the register of each servo for a group write.

    Raises:
        UnknownNameError: A servo has no such register.
    """
    own = [(servo, resolve_register(servo, ref)) for servo in servos]
    return [
        WriteTarget(
            servo,
            r,
            (servo.table.family, r.address, r.size),
            tracks_state(servo, r),
            r.access is Access.RW and r.area is Area.RAM,
        )
        for servo, r in own
    ]


def plan_reads(refs: Mapping[ServoSpec, Sequence[RegisterRef]]) -> ReadPlan:
    """Plan how to read the given registers of each servo.

    Raises:
        UnknownNameError: A servo has no such register.
    """
    own = {
        servo.id: {key: resolve_register(servo, key) for key in keys}
        for servo, keys in refs.items()
    }
    servos = {servo.id: servo for servo in refs}
    planned: list[ReadBatch] = []
    for runs in batches({i: row.values() for i, row in own.items()}, MAX_GAP_BYTES):
        members, first = [servos[i] for i in runs], next(iter(runs.values()))
        spans = {i: _cached_range(run[0].address, run[-1].end) for i, run in runs.items()}
        batch = ReadBatch(
            servos=members,
            spans=spans,
            layouts={i: ReplyLayout(servos[i], own[i], run) for i, run in runs.items()},
            description=f"read {', '.join(register.name for register in first)}",
            is_static=all(register.steady for run in runs.values() for register in run),
            groups=_group_by_family(members, spans),
        )
        planned.append(batch)
    return ReadPlan(tuple(servos), planned)


@cache
def _cached_range(address: int, end: int) -> MemoryRange:
    """Return the same object for equal ranges, because they are compared in every cycle."""
    return MemoryRange(address, end - address)


def _group_by_family(
    servos: Iterable[ServoSpec], spans: Mapping[int, MemoryRange]
) -> Mapping[Family, Mapping[int, MemoryRange]]:
    groups: dict[Family, dict[int, MemoryRange]] = {}
    for servo in servos:
        groups.setdefault(servo.table.family, {})[servo.id] = spans[servo.id]
    return groups


def batch_read(driver: ProtocolDriver, spans: Mapping[int, MemoryRange]) -> dict[int, Reply]:
    """Read a range of memory of each servo.

    This takes one sync read if all ranges are equal; otherwise one bulk read if the family supports
    it; otherwise a sync read for each range, or reads of one servo after another.
    """
    first = next(iter(spans.values()))
    if driver.can_sync_read and all(s is first or s == first for s in spans.values()):
        return driver.sync_read(tuple(spans), first.address, first.size)
    groups: dict[MemoryRange, list[int]] = defaultdict(list)
    for servo_id, span in spans.items():
        groups[span].append(servo_id)
    if len(groups) > 1 and (driver.can_bulk_read(spans) or not driver.can_sync_read):
        return driver.bulk_read(spans)
    replies: dict[int, Reply] = {}
    for span, servo_ids in groups.items():
        replies |= driver.sync_read(servo_ids, span.address, span.size)
    return replies


WriteBatch = Mapping[tuple[Family, int, int], Mapping[int, bytes]]
"""Bytes by servo id, for each family, address and number of bytes."""


def batch_write(drivers: Mapping[Family, ProtocolDriver], batch: WriteBatch) -> None:
    """Write to each servo at its own address, with one packet per family if possible."""
    for family in dict.fromkeys(family for family, _, _ in batch):
        driver = drivers[family]
        own = [(at, rows) for (of, at, _), rows in batch.items() if of is family]
        if len(own) > 1 and driver.can_bulk_write:
            driver.bulk_write({i: (at, data) for at, rows in own for i, data in rows.items()})
        else:
            for address, rows in own:
                driver.sync_write(address, rows)
