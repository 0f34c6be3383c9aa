"""Diagnose duplicate ids and unexpected servos on a bus."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence

from ikservo.errors import BadReplyError, IkservoError, PortError, PortLostError, ServoSilentError
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.ping_sweep import FRAMINGS, Framing, framing_of, ping_ids
from ikservo.hardware.port import Port
from ikservo.hardware.scan import FoundServo, candidate_baud_rates, identify
from ikservo.hardware.servo import ServoSpec

DUPLICATE_ID_HINT = (
    "Several servos may share one id. Give each its own, one at a time: ikservo setup ARM"
)

_PINGS = 6  # pings of each id, because two servos' replies overlap only by chance
_SAMPLES = 24  # pings of an id that is checked more closely
_ODD_FAULTS = 8  # this many faults among the samples prove two servos


def raise_explained(bus: ServoBus, error: IkservoError) -> None:
    """Raise an error that explains a failed request if possible; send only pings and reads.

    Two servos with one id cause replies that are damaged, doubled, or do not match the arm file. If
    servos are silent, other servos may be on the line; the search for these takes up to two
    seconds.

    Raises:
        BadReplyError: Several servos reply at one id; all such ids are named.
        ServoSilentError: Servos are silent, and servos with other ids were found; these are named.
        PortLostError: The port is lost.
    """
    raise_on_duplicate_ids(bus)
    if not isinstance(error, ServoSilentError):
        return
    silent = [s for i, s in bus.servos.items() if bus.statistics[i].lost_in_a_row]
    found = find_unexpected_servos(bus.port, silent, bus.servos)
    if found:
        listed = "; ".join(map(str, found))
        verb = "does" if len(silent) == 1 else "do"
        raise ServoSilentError(
            f"{verb} not answer at {bus.port.baudrate} baud; found instead: {listed}",
            _format_hint(found, silent, bus.port.baudrate),
            servo=error.servo,
            servo_id=error.servo_id,
            port=error.port,
        ) from error


def raise_on_duplicate_ids(bus: ServoBus) -> None:
    """Raise if two servos have the same id; see ``find_duplicate_ids``.

    Raises:
        BadReplyError: Several servos reply at one id; all such ids are named.
        PortLostError: The port is lost.
    """
    duplicates = find_duplicate_ids(bus)
    if duplicates:
        names = ", ".join(map(str, duplicates))
        found = "answers as if it were several servos"
        raise BadReplyError(found, DUPLICATE_ID_HINT, servo=names, port=bus.port.name)


def find_duplicate_ids(bus: ServoBus) -> list[ServoSpec]:
    """Find the ids at which several servos reply.

    Each id is pinged a few times, and more often if a reply is damaged or doubled. This takes about
    10 ms per servo, whatever the adapter's latency, and writes nothing.

    Raises:
        PortLostError: The port is lost.
    """
    duplicates: set[int] = set()
    for framing in FRAMINGS:
        ids = [i for i, servo in bus.servos.items() if servo.table.family in framing.families]
        if not ids:
            continue
        unused_id = next(i for i in framing.ids if i not in ids)  # the reply at this id is an echo
        pings = ping_ids(bus.port, framing, [unused_id, *(_PINGS * ids)])
        for servo_id in ids:
            odd = pings.junk or len(pings.frames.get(servo_id, ())) > _PINGS
            if odd and _is_duplicate_id(bus.port, framing, servo_id, echoes=pings.echoes):
                duplicates.add(servo_id)
    return [servo for servo in bus.servos.values() if servo.id in duplicates]


def _is_duplicate_id(port: Port, framing: Framing, servo_id: int, *, echoes: bool) -> bool:
    pings = ping_ids(port, framing, _SAMPLES * [servo_id], echoes=echoes, one_by_one=True)
    surplus = len(pings.frames.get(servo_id, ())) - _SAMPLES
    return surplus >= _ODD_FAULTS or bool(pings.junk and surplus <= -_ODD_FAULTS)


_NO_REPLY = 251  # an unused id: only an adapter that echoes returns bytes for it
_NEW_IDS = (1,)  # factory ids
_MAX_FOUND = 3  # servos checked closely; more would not change the message


def find_unexpected_servos(
    port: Port, silent: Sequence[ServoSpec], known: Collection[int]
) -> list[FoundServo]:
    """Find servos that may be the silent servos: first those with expected ids, then any others.

    ``known`` contains the ids that should be on the line. The port keeps its baud rate.

    Raises:
        PortLostError: The port is lost.
    """
    rate, ids = port.baudrate, {servo.id for servo in silent}
    try:
        for other_rate in [rate, *(r for r in candidate_baud_rates() if r != rate)]:
            candidates = ids if other_rate == rate else ids | set(_NEW_IDS)
            found = list(_responding_servos(port, other_rate, candidates))
            if found:
                return found
        return list(_responding_servos(port, rate, set(range(_NO_REPLY)) - set(known)))
    finally:
        port.setBaudRate(rate)


def _responding_servos(port: Port, rate: int, ids: Iterable[int]) -> Iterator[FoundServo]:
    """Yield the servos with given ids that reply at a rate, in either framing."""
    try:
        port.setBaudRate(rate)
    except PortLostError:
        raise
    except PortError:  # the adapter does not support this rate
        return
    for framing in FRAMINGS:
        if rate not in framing.baud_rates:
            continue
        pings = ping_ids(port, framing, [*sorted(ids), _NO_REPLY])
        for servo_id in sorted(pings.suspects | pings.frames.keys() - {_NO_REPLY})[:_MAX_FOUND]:
            found = identify(port, framing, servo_id, echoes=pings.echoes)
            if found:
                yield found


def _format_hint(found: Sequence[FoundServo], silent: Sequence[ServoSpec], rate: int) -> str:
    framings = {framing_of(servo.table.family).name for servo in silent}
    if not framings.intersection(servo.protocol for servo in found):
        return "If this is another arm, choose it with --arm. List all servos: ikservo scan"
    if all(servo.baud_rate != rate for servo in found):
        return "Set this rate: ikservo setup ARM. If this is another arm, choose it with --arm."
    return "Give each its own id: ikservo setup ARM. If this is another arm, choose it with --arm."
