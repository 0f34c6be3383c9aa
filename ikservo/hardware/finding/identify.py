"""A closer look at one id: which model, how it is, and whether it is really only one servo."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from ikservo.errors import BadReplyError, BusError
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.drivers.choice import driver_for
from ikservo.hardware.finding.sweep import sweep
from ikservo.hardware.line.port import Port
from ikservo.hardware.packets.framing import Framing
from ikservo.hardware.packets.replies import Status
from ikservo.hardware.servo import ServoSpec
from ikservo.registers import MODELS, Family, Role, ServoTable, table_with_number

__all__ = ["Found", "firmware_of", "look_closer"]

_TRIES = 8  # pings of one id; two servos rarely answer alike so often
_CROWD = 2  # answers damaged or doubled; one may be chance
_READS = 4
_HEAD_BYTES = 8  # the first registers of protocol 1: model, firmware and id are among them


@dataclass(frozen=True, slots=True)
class Found:
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
        crowded: More than one servo answers at this id; what they are cannot be told.
    """

    id: int
    baud_rate: int
    protocol: str
    table: type[ServoTable] | None = None
    model_number: int | None = None
    firmware: str = ""
    voltage_v: float | None = None
    temperature_c: float | None = None
    alarms: tuple[str, ...] = ()
    crowded: bool = False

    @property
    def model(self) -> str:
        """Return the model's name, or its number where no table is known."""
        if self.table:
            return self.table.model_name
        return "" if self.model_number is None else f"unknown model {self.model_number}"

    def __str__(self) -> str:
        what = "several servos" if self.crowded else self.model or "a servo"
        return f"{what} at id {self.id}, {self.baud_rate} baud"


def look_closer(
    port: Port, framing: Framing, servo_id: int, *, echoes: bool = False
) -> Found | None:
    """Return who answers at an id at the port's baud rate; None if nobody does.

    Raises:
        PortLostError: The line is gone.
    """
    heard = sweep(port, framing, [servo_id] * _TRIES, echoes=echoes, calm=True)
    answers = heard.frames.get(servo_id, [])
    found = Found(servo_id, port.baudrate, framing.name)
    if not answers and not heard.junk:
        return None
    damaged = _TRIES - len(answers) if heard.junk else 0
    if damaged >= _CROWD or len(answers) >= _TRIES + _CROWD:
        return replace(found, crowded=True)
    return _described(port, _identified(port, framing, found, answers[0].data))


def firmware_of(bus: ServoBus, servo_id: int) -> str:
    """Return a servo's firmware version as its vendor writes it.

    Raises:
        BusError: It does not answer.
    """
    registers = bus.servos[servo_id].table.registers
    names = [name for name in _FIRMWARE if name in registers]
    return ".".join(f"{bus.read(servo_id, registers[name], raw=True)}" for name in names)


_FIRMWARE = ("firmware_major", "firmware_minor", "firmware_version")


def _identified(port: Port, framing: Framing, found: Found, said: bytes) -> Found:
    if Family.DYNAMIXEL_2 in framing.families:
        number = int.from_bytes(said[:2], "little")
        return replace(
            found, model_number=number, table=table_with_number(Family.DYNAMIXEL_2, number)
        )
    head = _head(port, found.id)
    if head is None:
        return found
    tables = [table for table in MODELS.values() if table.family in framing.families]
    for table in tables:
        if _reads(head, table) == (table.number, found.id):
            return replace(found, model_number=table.number, table=table)
    return replace(found, model_number=_likely_number(head, found.id, tables))


def _head(port: Port, servo_id: int) -> bytes | None:
    """Return the first registers; all families of protocol 1 are read alike."""
    driver = driver_for(Family.FEETECH_STS, port)
    for _ in range(_READS):
        reply = driver.read(servo_id, 0, _HEAD_BYTES)
        if isinstance(reply, Status):
            return reply.data
    return None


def _reads(head: bytes, table: type[ServoTable]) -> tuple[int, int]:
    """Return model number and id as they stand in the memory if it is laid out like the table."""
    model, own_id = table.model_number, table.id
    return (
        model.decode(head[model.address : model.end]),
        own_id.decode(head[own_id.address : own_id.end]),
    )


def _likely_number(head: bytes, servo_id: int, tables: Iterable[type[ServoTable]]) -> int | None:
    """Return an unknown model's number, by the family in whose place for the id the id stands."""
    readings = [_reads(head, table) for table in tables]
    return next((number for number, own_id in readings if own_id == servo_id), None)


def _described(port: Port, found: Found) -> Found:
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
        Found(found.id, found.baud_rate, found.protocol, crowded=True)
        if damaged >= _CROWD
        else found
    )


def _with_health(bus: ServoBus, found: Found) -> Found:
    roles = (Role.PRESENT_POSITION, Role.PRESENT_VOLTAGE, Role.PRESENT_TEMPERATURE, Role.ALARMS)
    wanted = [role for role in roles if role not in bus.servos[found.id].table.lacks]
    values = bus.sync_read_many([found.id], wanted).complete()[found.id]
    return replace(
        found,
        firmware=found.firmware or firmware_of(bus, found.id),
        voltage_v=values[Role.PRESENT_VOLTAGE],
        temperature_c=values[Role.PRESENT_TEMPERATURE],
        alarms=tuple(sorted(str(alarm) for alarm in bus.alarms[found.id])),
    )
