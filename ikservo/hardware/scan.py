"""Scan all baud rates and identify the servos that reply."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

from ikservo.errors import BadReplyError, BusError, PortError, PortLostError
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.packets import Status
from ikservo.hardware.ping_sweep import FRAMINGS, Framing, ping_ids
from ikservo.hardware.port import Port
from ikservo.hardware.requester import make_driver
from ikservo.hardware.servo import ServoSpec
from ikservo.registers import MODELS, ControlTable, Family, RegisterName, control_table_for_number

__all__ = [
    "FoundServo",
    "OnScanStep",
    "ScanProgress",
    "candidate_baud_rates",
    "firmware_version",
    "identify",
    "scan",
    "scan_rate",
]


_MAX_RETRIES = 8  # pings of one id; two servos rarely answer alike so often
_DUPLICATE_REPLIES = 2  # answers damaged or doubled; one may be chance
_READS = 4
_HEAD_BYTES = 8  # the first registers of protocol 1: model, firmware and id are among them


@dataclass(frozen=True, slots=True)
class FoundServo:
    """Who answers at an id.

    Attributes:
        id: The id.
        baud_rate: At which it answers.
        protocol: The framing it speaks, for a person.
        table: Its control table, None where the model is not known.
        model_number: What its model register says; None where it does not tell.
        firmware: Its version, as the vendor writes it.
        voltage_v: At its plug.
        temperature_c: Inside.
        alarms: What it complains about.
        shares_id: More than one servo answers at this id; what they are cannot be told.
    """

    id: int
    baud_rate: int
    protocol: str
    table: type[ControlTable] | None = None
    model_number: int | None = None
    firmware: str = ""
    voltage_v: float | None = None
    temperature_c: float | None = None
    alarms: tuple[str, ...] = ()
    shares_id: bool = False

    @property
    def model(self) -> str:
        """Return the model's name, or its number where no table is known."""
        if self.table:
            return self.table.model_name
        return "" if self.model_number is None else f"unknown model {self.model_number}"

    def __str__(self) -> str:
        what = "several servos" if self.shares_id else self.model or "a servo"
        return f"{what} at id {self.id}, {self.baud_rate} baud"


def identify(
    port: Port, framing: Framing, servo_id: int, *, echoes: bool = False
) -> FoundServo | None:
    """Return who answers at an id at the port's baud rate; None if nobody does.

    Raises:
        PortLostError: The line is gone.
    """
    heard = ping_ids(port, framing, [servo_id] * _MAX_RETRIES, echoes=echoes, calm=True)
    answers = heard.frames.get(servo_id, [])
    found = FoundServo(servo_id, port.baudrate, framing.name)
    if not answers and not heard.junk:
        return None
    damaged = _MAX_RETRIES - len(answers) if heard.junk else 0
    if damaged >= _DUPLICATE_REPLIES or len(answers) >= _MAX_RETRIES + _DUPLICATE_REPLIES:
        return replace(found, shares_id=True)
    return _with_details(port, _identify_model(port, framing, found, answers[0].data))


def firmware_version(bus: ServoBus, servo_id: int) -> str:
    """Return a servo's firmware version as its vendor writes it.

    Raises:
        BusError: It does not answer.
    """
    registers = bus.servos[servo_id].table.registers
    names = [name for name in _FIRMWARE if name in registers]
    return ".".join(f"{bus.read(servo_id, registers[name], raw=True)}" for name in names)


_FIRMWARE = ("firmware_major", "firmware_minor", "firmware_version")


def _identify_model(port: Port, framing: Framing, found: FoundServo, said: bytes) -> FoundServo:
    if Family.DYNAMIXEL_2 in framing.families:
        number = int.from_bytes(said[:2], "little")
        return replace(
            found, model_number=number, table=control_table_for_number(Family.DYNAMIXEL_2, number)
        )
    head = _read_first_registers(port, found.id)
    if head is None:
        return found
    tables = [table for table in MODELS.values() if table.family in framing.families]
    for table in tables:
        if _decode_identity(head, table) == (table.number, found.id):
            return replace(found, model_number=table.number, table=table)
    return replace(found, model_number=_guess_model_number(head, found.id, tables))


def _read_first_registers(port: Port, servo_id: int) -> bytes | None:
    """Return the first registers; all families of protocol 1 are read alike."""
    driver = make_driver(Family.FEETECH_STS, port)
    for _ in range(_READS):
        reply = driver.read(servo_id, 0, _HEAD_BYTES)
        if isinstance(reply, Status):
            return reply.data
    return None


def _decode_identity(head: bytes, table: type[ControlTable]) -> tuple[int, int]:
    """Return model number and id as they stand in the memory if it is laid out like the table."""
    model, own_id = table.model_number, table.id
    return (
        model.decode(head[model.address : model.end]),
        own_id.decode(head[own_id.address : own_id.end]),
    )


def _guess_model_number(
    head: bytes, servo_id: int, tables: Iterable[type[ControlTable]]
) -> int | None:
    """Return an unknown model's number, by the family in whose place for the id the id stands."""
    readings = [_decode_identity(head, table) for table in tables]
    return next((number for number, own_id in readings if own_id == servo_id), None)


def _with_details(port: Port, found: FoundServo) -> FoundServo:
    if found.table is None:
        return found
    bus = ServoBus(port, [ServoSpec(found.id, found.table)], retries=0)
    damaged = 0
    for _ in range(_READS):
        try:
            found = _with_health(bus, found)
        except BadReplyError:
            damaged += 1
        except BusError:  # silent for once: what is known is enough
            continue
    return (
        FoundServo(found.id, found.baud_rate, found.protocol, shares_id=True)
        if damaged >= _DUPLICATE_REPLIES
        else found
    )


def _with_health(bus: ServoBus, found: FoundServo) -> FoundServo:
    roles = (
        RegisterName.PRESENT_POSITION,
        RegisterName.PRESENT_VOLTAGE,
        RegisterName.PRESENT_TEMPERATURE,
        RegisterName.ALARMS,
    )
    wanted = [role for role in roles if role not in bus.servos[found.id].table.missing]
    values = bus.sync_read_many([found.id], wanted).require_all()[found.id]
    return replace(
        found,
        firmware=found.firmware or firmware_version(bus, found.id),
        voltage_v=values[RegisterName.PRESENT_VOLTAGE],
        temperature_c=values[RegisterName.PRESENT_TEMPERATURE],
        alarms=tuple(sorted(str(alarm) for alarm in bus.alarms[found.id])),
    )


# What servos are delivered with, and what people set them to; the others follow from fast to slow.
_COMMON_RATES = (1_000_000, 57_600, 115_200, 2_000_000, 3_000_000, 4_000_000, 500_000)


@dataclass(frozen=True, slots=True)
class ScanProgress:
    """How far a scan is.

    Attributes:
        baud_rate: The rate of the moment.
        protocol: The framing of the moment.
        asked: Ids asked so far at this rate and framing.
        ids: How many there are.
    """

    baud_rate: int
    protocol: str
    asked: int
    ids: int


OnScanStep = Callable[[ScanProgress], None]
"""Who wants to know how far it is."""


def candidate_baud_rates(first: int | None = None) -> list[int]:
    """Return every rate that a known servo can be set to, the likely ones first.

    Args:
        first: A rate to begin with.
    """
    known = frozenset[int]().union(*(framing.baud_rates for framing in FRAMINGS))
    rates = [first] if first else []
    rates += [rate for rate in _COMMON_RATES if rate in known]
    return list(dict.fromkeys([*rates, *sorted(known, reverse=True)]))


def scan(
    port: Port,
    rates: Iterable[int] | None = None,
    *,
    every: bool = False,
    on_step: OnScanStep | None = None,
) -> list[FoundServo]:
    """Return the servos that answer, at the first rate at which any does.

    The port is left at the rate of the last servo that was found.

    Args:
        port: The line.
        rates: In this order; all known ones if None.
        every: Go on to the last rate.
        on_step: Told how far it is.

    Raises:
        PortLostError: The line is gone.
    """
    found: list[FoundServo] = []
    for rate in candidate_baud_rates() if rates is None else rates:
        found += scan_rate(port, rate, on_step=on_step)
        if found and not every:
            break
    if found:
        port.setBaudRate(found[-1].baud_rate)
    return found


def scan_rate(
    port: Port,
    rate: int,
    framings: Iterable[Framing] = FRAMINGS,
    on_step: OnScanStep | None = None,
) -> list[FoundServo]:
    """Return the servos that answer at one rate, by id; none where the adapter cannot make it.

    Raises:
        PortLostError: The line is gone.
    """
    try:
        port.setBaudRate(rate)
    except PortLostError:
        raise
    except PortError:  # the adapter cannot make this rate
        return []
    speaking = [framing for framing in framings if _supports_rate(framing, rate)]
    return [found for framing in speaking for found in _scan_framing(port, framing, on_step)]


def _supports_rate(framing: Framing, rate: int) -> bool:
    """A rate that no table knows may be anybody's."""
    return rate in framing.baud_rates or not any(rate in f.baud_rates for f in FRAMINGS)


def _scan_framing(port: Port, framing: Framing, on_step: OnScanStep | None) -> Iterator[FoundServo]:
    def tell(count: int) -> None:
        if on_step:
            on_step(ScanProgress(port.baudrate, framing.name, count, len(framing.ids)))

    heard = ping_ids(port, framing, framing.ids, tell)
    there = heard.suspects | heard.frames.keys()
    if there:  # somebody is on the line: who has not answered is asked once more
        rest = [servo_id for servo_id in framing.ids if servo_id not in there]
        there |= ping_ids(port, framing, rest, echoes=heard.echoes).frames.keys()
    for servo_id in sorted(there):
        found = identify(port, framing, servo_id, echoes=heard.echoes)
        if found:
            yield found
