"""Waiting for a person: a servo is plugged in, or pulled out again."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import count, product

from ikservo.errors import ServoSilentError
from ikservo.hardware.finding.identify import Found, look_closer
from ikservo.hardware.finding.scanning import baud_rates, scan_rate
from ikservo.hardware.line.port import Port
from ikservo.hardware.packets.framing import FRAMINGS, Framing, framing_of
from ikservo.registers import ServoTable

__all__ = ["await_none", "await_one"]

_FACTORY_RATES = (1_000_000, 57_600)  # Feetech's and ROBOTIS'
_LOW_IDS = range(21)  # what servos are delivered with and most arms use: quick to try everywhere
_EVERY = 4  # looks, of which one tries every rate at low ids and one every rate at every id
_PAUSE_S = 0.1

Tell = Callable[[Sequence[Found]], None]
TellRate = Callable[[int], None]
Place = tuple[int, Framing]
"""A baud rate and the framing of packets at it."""


def await_one(
    port: Port,
    table: type[ServoTable],
    rate: int,
    wait_s: float,
    tell: Tell,
    tell_rate: TellRate | None = None,
) -> Found:
    """Return the one servo that answers, once the same has answered twice in a row.

    It may have any known baud rate and be of any family. While several answer, which two servos
    at one id do as well, it goes on waiting.

    Args:
        port: The line.
        table: What is expected; its protocol is tried most often.
        rate: At which it may answer already, besides those of a new servo.
        wait_s: How long to wait.
        tell: Told who answers each time that changes.
        tell_rate: Told each baud rate before it is tried.

    Raises:
        ServoSilentError: No servo came, or several stayed.
        PortLostError: The line is gone.
    """
    before: list[Found] = []
    last: list[Found] = []
    give_up_s = port.clock.now_s() + wait_s
    for look in count():
        found = _look(port, _search(table, rate, before, look), tell_rate)
        if _where(found) != _where(before):
            tell(found)
        if len(found) == 1 and not found[0].crowded and _where(found) == _where(before):
            return found[0]
        before, last = found, found or last
        if port.clock.now_s() > give_up_s:
            raise _vain(port, last, wait_s)
        _rest(port)
    raise AssertionError  # count() has no end


def await_none(port: Port, found: Found, wait_s: float) -> None:
    """Return once a servo does not answer any more; others may.

    Raises:
        ServoSilentError: It was not pulled out in time.
        PortLostError: The line is gone.
    """
    give_up_s = port.clock.now_s() + wait_s
    assert found.table is not None  # noqa: S101  # a servo of no known model is never set up
    framing = framing_of(found.table.family)
    port.setBaudRate(found.baud_rate)
    while look_closer(port, framing, found.id):
        if port.clock.now_s() > give_up_s:
            still = f"still has a servo with id {found.id} after {wait_s:.0f} s"
            raise ServoSilentError(still, "Unplug the servo that is done.", port=port.name)
        _rest(port)


def _look(port: Port, places: Iterable[Place], tell_rate: TellRate | None) -> list[Found]:
    found: list[Found] = []
    for rate, framing in places:
        if tell_rate:
            tell_rate(rate)
        found += scan_rate(port, rate, [framing])
    return found


def _search(table: type[ServoTable], rate: int, before: Sequence[Found], look: int) -> list[Place]:
    """Return where to look this time: always where somebody answered the last time.

    That one is confirmed at once, without the long search through all rates.
    """
    own = framing_of(table.family)
    places = [(found.baud_rate, _framing_named(found.protocol)) for found in before]
    known = set(table.baud_rates.values())
    places += [(r, own) for r in (rate, *_FACTORY_RATES) if r in known or r == rate]
    if not before and look % _EVERY == 1:
        places += product(baud_rates(), [replace(framing, ids=_LOW_IDS) for framing in FRAMINGS])
    if not before and look % _EVERY == _EVERY - 1:
        places += product(baud_rates(), [own])
        places += product(baud_rates(), FRAMINGS)
    return list(dict.fromkeys(places))


def _framing_named(name: str) -> Framing:
    return next(framing for framing in FRAMINGS if framing.name == name)


def _where(found: Sequence[Found]) -> list[tuple[int, int, bool]]:
    return [(servo.id, servo.baud_rate, servo.crowded) for servo in found]


def _vain(port: Port, last: Sequence[Found], wait_s: float) -> ServoSilentError:
    """Return the error that says who answered last, if anybody did."""
    if not last:
        found = f"brings no servo within {wait_s:.0f} s (all ids, {len(baud_rates())} baud rates)"
        return ServoSilentError(found, "Check its plug and its power supply.", port=port.name)
    if len(last) == 1 and not last[0].crowded:
        found = f"brings answers of {last[0]}, but not steadily, for {wait_s:.0f} s"
        return ServoSilentError(found, "Check its plug and its power supply.", port=port.name)
    what = "several servos at one id" if len(last) == 1 else f"{len(last)} servos"
    hint = "Leave only one plugged in: the others would be changed with it."
    return ServoSilentError(
        f"brings {what} instead of one, for {wait_s:.0f} s", hint, port=port.name
    )


def _rest(port: Port) -> None:
    port.clock.sleep_until(port.clock.now_s() + _PAUSE_S)
