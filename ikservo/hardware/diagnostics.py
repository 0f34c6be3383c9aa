"""Diagnose duplicate ids and unexpected servos on a bus."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Generator, Iterable, Iterator, Sequence

from ikservo.errors import (
    BadReplyError,
    BusError,
    CalibrationError,
    PortError,
    PortLostError,
    ServoSilentError,
)
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.ping_sweep import FRAMINGS, Framing, framing_of, ping_ids
from ikservo.hardware.port import Port
from ikservo.hardware.scan import FoundServo, candidate_baud_rates, identify
from ikservo.hardware.servo import ServoSpec

__all__ = [
    "DUPLICATE_ID_HINT",
    "detecting_duplicate_ids",
    "explaining_silence",
    "find_duplicate_ids",
    "raise_on_duplicate_ids",
    "strangers",
]


DUPLICATE_ID_HINT = (
    "Several servos may share one id. Give each its own, one at a time: ikservo setup ARM"
)

_PINGS = 6  # of each id; the answers of two servos fit over each other by chance now and then
_SAMPLES = 24  # pings of an id that is looked at more closely
_ODD_FAULTS = 8  # of them that two servos spoil at least, and that a bad line does not


@contextlib.contextmanager
def detecting_duplicate_ids(bus: ServoBus) -> Generator[None]:
    """Ask servos something, and say so if two with one id spoilt it.

    Two that share an id damage or double each other's answers, or contradict the arm file. Where
    nothing of this happened nothing more is asked, so that a healthy line loses no time.

    Raises:
        BadReplyError: More than one servo answers at an id; names all such.
        PortLostError: The line is gone.
    """
    try:
        yield
    except (BusError, CalibrationError):
        raise_on_duplicate_ids(bus)
        raise
    if bus.port.trust.degraded:
        raise_on_duplicate_ids(bus)


def raise_on_duplicate_ids(bus: ServoBus) -> None:
    """Find out whether two servos share an id; see ``crowded``.

    Raises:
        BadReplyError: More than one servo answers at an id; names all such.
        PortLostError: The line is gone.
    """
    crowds = find_duplicate_ids(bus)
    if crowds:
        named = ", ".join(map(str, crowds))
        raise BadReplyError(
            "answers like several servos", DUPLICATE_ID_HINT, servo=named, port=bus.port.name
        )


def find_duplicate_ids(bus: ServoBus) -> list[ServoSpec]:
    """Return the servos at whose ids more than one answers.

    Each is pinged a few times, and more often where an answer is damaged or doubled. This takes
    about 10 ms a servo, whatever the adapter's latency, and writes nothing.

    Raises:
        PortLostError: The line is gone.
    """
    crowds: list[int] = []
    for framing in FRAMINGS:
        ids = [i for i, servo in bus.servos.items() if servo.table.family in framing.families]
        crowds += _duplicate_ids(bus.port, framing, ids) if ids else ()
    return [servo for servo in bus.servos.values() if servo.id in crowds]


def _duplicate_ids(port: Port, framing: Framing, ids: Collection[int]) -> Iterator[int]:
    absent = next(i for i in framing.ids if i not in ids)  # an echo of what nobody answers tells
    heard = ping_ids(port, framing, [absent, *(_PINGS * [*ids])])
    for servo_id in ids:
        odd = heard.junk or len(heard.frames.get(servo_id, ())) > _PINGS
        if odd and _is_duplicate_id(port, framing, servo_id, echoes=heard.echoes):
            yield servo_id


def _is_duplicate_id(port: Port, framing: Framing, servo_id: int, *, echoes: bool) -> bool:
    heard = ping_ids(port, framing, _SAMPLES * [servo_id], echoes=echoes, calm=True)
    surplus = len(heard.frames.get(servo_id, ())) - _SAMPLES
    return surplus >= _ODD_FAULTS or bool(heard.junk and surplus <= -_ODD_FAULTS)


_NO_REPLY = 251  # an id that nobody has: only an adapter that hears itself brings something for it
_NEW_IDS = (1,)  # as delivered
_MAX_FOUND = 3  # servos looked at closely; more would say the same


@contextlib.contextmanager
def explaining_silence(bus: ServoBus) -> Generator[None]:
    """Ask servos something; where some are silent, say who is on the line instead.

    Only pings and reads are sent. It takes up to two seconds, after a failure alone.

    Raises:
        ServoSilentError: As it was, and who answers in their place.
        PortLostError: The line is gone.
    """
    try:
        yield
    except ServoSilentError as error:
        silent = [s for i, s in bus.servos.items() if bus.statistics[i].lost_in_a_row]
        found = strangers(bus.port, silent, bus.servos)
        if not found:
            raise
        listed = "; ".join(map(str, found))
        verb = "does" if len(silent) == 1 else "do"
        at = f"{verb} not answer at {bus.port.baudrate} baud"
        raise ServoSilentError(
            f"{at}; there is {listed}",
            _format_hint(found, silent, bus.port.baudrate),
            servo=error.servo,
            servo_id=error.servo_id,
            port=error.port,
        ) from error


def strangers(port: Port, silent: Sequence[ServoSpec], known: Collection[int]) -> list[FoundServo]:
    """Return some of those who may be the silent servos: at their ids first, then at any.

    Args:
        port: The line; it is left at the rate at which it was.
        silent: Who does not answer.
        known: The ids of all servos that should be on the line.

    Raises:
        PortLostError: The line is gone.
    """
    rate, ids = port.baudrate, {servo.id for servo in silent}
    try:
        for other_rate in [rate, *(r for r in candidate_baud_rates() if r != rate)]:
            asked = ids if other_rate == rate else ids | set(_NEW_IDS)
            found = list(_responding_servos(port, other_rate, asked))
            if found:
                return found
        return list(_responding_servos(port, rate, set(range(_NO_REPLY)) - set(known)))
    finally:
        port.setBaudRate(rate)


def _responding_servos(port: Port, rate: int, ids: Iterable[int]) -> Iterator[FoundServo]:
    """Yield those of some ids who answer at a rate, in either framing."""
    if not _is_set(port, rate):
        return
    for framing in FRAMINGS:
        if rate in framing.baud_rates:
            yield from _responding_in_framing(port, framing, sorted(ids))


def _responding_in_framing(
    port: Port, framing: Framing, ids: Sequence[int]
) -> Iterator[FoundServo]:
    heard = ping_ids(port, framing, [*ids, _NO_REPLY])
    for servo_id in sorted(heard.suspects | heard.frames.keys() - {_NO_REPLY})[:_MAX_FOUND]:
        found = identify(port, framing, servo_id, echoes=heard.echoes)
        if found:
            yield found


def _is_set(port: Port, rate: int) -> bool:
    try:
        return port.setBaudRate(rate)
    except PortLostError:
        raise
    except PortError:  # the adapter cannot make this rate
        return False


def _format_hint(found: Sequence[FoundServo], silent: Sequence[ServoSpec], rate: int) -> str:
    wanted = {framing_of(servo.table.family).name for servo in silent}
    if not wanted.intersection(one.protocol for one in found):
        return "If this is another arm, choose it with --arm. List all servos: ikservo scan"
    if all(one.baud_rate != rate for one in found):
        return "Set this rate: ikservo setup ARM. If this is another arm, choose it with --arm."
    return "Give each its own id: ikservo setup ARM. If this is another arm, choose it with --arm."
