"""Scan all baud rates and identify the servos that reply."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from ikservo.errors import BadReplyError, BusError, PortError, PortLostError
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.eeprom import firmware_version
from ikservo.hardware.packets import Status
from ikservo.hardware.ping_sweep import FRAMINGS, Framing, ping_ids
from ikservo.hardware.port import Port, open_port
from ikservo.hardware.requester import make_driver
from ikservo.hardware.servo import ServoSpec
from ikservo.registers import MODELS, ControlTable, Family, RegisterName, control_table_for_number

_MAX_RETRIES = 8  # number of pings of one id; two servos rarely send equal replies so often
_DUPLICATE_REPLIES = 2  # damaged or doubled replies that prove two servos; one may be chance
_READS = 4
_HEAD_BYTES = 8  # the first registers of protocol 1: model, firmware and id are among them


@dataclass(frozen=True, slots=True)
class FoundServo:
    """A servo that replied to a scan.

    Attributes:
        id: The id.
        baud_rate: The rate at which it replies.
        protocol: The name of its framing, for messages.
        table: The control table; None if the model is not known.
        model_number: The model register; None if it is not readable.
        firmware: The firmware version, in the vendor's notation.
        voltage_v: The voltage at its plug.
        temperature_c: The temperature inside it.
        alarms: The alarms.
        shares_id: Whether more than one servo replies at this id; their data are unknown.
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
        """The model's name, or its number if no table is known."""
        if self.table:
            return self.table.model_name
        return "" if self.model_number is None else f"unknown model {self.model_number}"

    def __str__(self) -> str:
        what = "several servos" if self.shares_id else self.model or "a servo"
        return f"{what} at id {self.id}, {self.baud_rate} baud"


def identify(
    port: Port, framing: Framing, servo_id: int, *, echoes: bool = False
) -> FoundServo | None:
    """Identify the servo with an id at the port's baud rate; None if no servo replies.

    Raises:
        PortLostError: The port is lost.
    """
    pings = ping_ids(port, framing, [servo_id] * _MAX_RETRIES, echoes=echoes, one_by_one=True)
    replies = pings.frames.get(servo_id, [])
    found = FoundServo(servo_id, port.baudrate, framing.name)
    if not replies and not pings.junk:
        return None
    damaged = _MAX_RETRIES - len(replies) if pings.junk else 0
    if damaged >= _DUPLICATE_REPLIES or len(replies) >= _MAX_RETRIES + _DUPLICATE_REPLIES:
        return replace(found, shares_id=True)
    return _with_details(port, _identify_model(port, framing, found, replies[0].data))


def _identify_model(port: Port, framing: Framing, found: FoundServo, data: bytes) -> FoundServo:
    if Family.DYNAMIXEL_2 in framing.families:
        number = int.from_bytes(data[:2], "little")
        return replace(
            found, model_number=number, table=control_table_for_number(Family.DYNAMIXEL_2, number)
        )
    head = _read_first_registers(port, found.id)
    if head is None:
        return found
    tables = [table for table in MODELS.values() if table.family in framing.families]
    guess: int | None = None
    for table in tables:
        model, own_id = table.model_number, table.id
        if own_id.decode(head[own_id.address : own_id.end]) != found.id:
            continue  # the memory of this family has another layout
        number = model.decode(head[model.address : model.end])
        if number == table.number:
            return replace(found, model_number=number, table=table)
        guess = number if guess is None else guess
    return replace(found, model_number=guess)


def _read_first_registers(port: Port, servo_id: int) -> bytes | None:
    """Read the first registers by the instruction that all families of protocol 1 share."""
    driver = make_driver(Family.FEETECH_STS, port)
    for _ in range(_READS):
        reply = driver.read(servo_id, 0, _HEAD_BYTES)
        if isinstance(reply, Status):
            return reply.data
    return None


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
        except BusError:  # the identity is enough
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
    names = [role for role in roles if role not in bus.servos[found.id].table.missing]
    values = bus.sync_read_many([found.id], names).require_all()[found.id]
    return replace(
        found,
        firmware=found.firmware or firmware_version(bus, found.id),
        voltage_v=values[RegisterName.PRESENT_VOLTAGE],
        temperature_c=values[RegisterName.PRESENT_TEMPERATURE],
        alarms=tuple(sorted(str(alarm) for alarm in bus.alarms[found.id])),
    )


# Factory settings and frequent user settings; the others follow from fast to slow.
_COMMON_RATES = (1_000_000, 57_600, 115_200, 2_000_000, 3_000_000, 4_000_000, 500_000)


@dataclass(frozen=True, slots=True)
class ScanProgress:
    """Progress of a scan at one rate and framing: number of ids pinged so far, and of all ids."""

    baud_rate: int
    protocol: str
    pinged: int
    ids: int


OnScanStep = Callable[[ScanProgress], None]
"""Callback for the progress of a scan."""


def candidate_baud_rates(first: int | None = None) -> list[int]:
    """Return all rates of known models: ``first``, if given, then likely rates, then the others."""
    known = frozenset[int]().union(*(framing.baud_rates for framing in FRAMINGS))
    rates = [first] if first else []
    rates += [rate for rate in _COMMON_RATES if rate in known]
    return list(dict.fromkeys([*rates, *sorted(known, reverse=True)]))


def scan(
    port: Port,
    rates: Iterable[int] | None = None,
    *,
    all_rates: bool = False,
    on_step: OnScanStep | None = None,
) -> list[FoundServo]:
    """Return the servos that reply at the first rate at which any servo replies.

    The port is left at the rate of the last servo that was found. With ``all_rates``, the scan
    continues to the last of the rates, which by default are all known rates.

    Raises:
        PortLostError: The port is lost.
    """
    found: list[FoundServo] = []
    for rate in candidate_baud_rates() if rates is None else rates:
        found += scan_rate(port, rate, on_step=on_step)
        if found and not all_rates:
            break
    if found:
        port.setBaudRate(found[-1].baud_rate)
    return found


def scan_servo(port: Port, servo_id: int, rates: Iterable[int]) -> list[FoundServo]:
    """Return the servo with an id, at the first rate at which it replies; empty if silent.

    Raises:
        PortLostError: The port is lost.
    """
    framings = [replace(framing, ids=range(servo_id, servo_id + 1)) for framing in FRAMINGS]
    for rate in rates:
        if found := scan_rate(port, rate, framings):
            return found
    return []


def scan_rate(
    port: Port, rate: int, framings: Iterable[Framing] = FRAMINGS, on_step: OnScanStep | None = None
) -> list[FoundServo]:
    """Return the servos that reply at one rate, by id; empty if the adapter does not support it.

    Raises:
        PortLostError: The port is lost.
    """
    try:
        port.setBaudRate(rate)
    except PortLostError:
        raise
    except PortError:  # the adapter does not support this rate
        return []
    is_known = any(rate in framing.baud_rates for framing in FRAMINGS)  # others may be tried, too
    supported = [framing for framing in framings if rate in framing.baud_rates or not is_known]
    return [found for framing in supported for found in _scan_framing(port, framing, on_step)]


def _scan_framing(port: Port, framing: Framing, on_step: OnScanStep | None) -> Iterator[FoundServo]:
    def report(count: int) -> None:
        if on_step:
            on_step(ScanProgress(port.baudrate, framing.name, count, len(framing.ids)))

    pings = ping_ids(port, framing, framing.ids, report)
    replying = pings.suspects | pings.frames.keys()
    if replying:  # servos are on the line: ping the remaining ids once more
        rest = [servo_id for servo_id in framing.ids if servo_id not in replying]
        replying |= ping_ids(port, framing, rest, echoes=pings.echoes).frames.keys()
    for servo_id in sorted(replying):
        found = identify(port, framing, servo_id, echoes=pings.echoes)
        if found:
            yield found


def scan_port(
    name: str, rates: Sequence[int], *, all_rates: bool = False, on_step: OnScanStep | None = None
) -> list[FoundServo]:
    """Open a port, return the servos that reply on it, and close it; see ``scan``.

    Raises:
        PortError: The port cannot be opened, or is lost.
    """
    with open_port(name, rates[0]) as port:
        return scan(port, rates, all_rates=all_rates, on_step=on_step)
