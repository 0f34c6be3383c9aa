"""Who is on the line: every id at every baud rate in every protocol."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from ikservo.errors import PortError, PortLostError
from ikservo.hardware.finding.identify import Found, look_closer
from ikservo.hardware.finding.sweep import sweep
from ikservo.hardware.line.port import Port
from ikservo.hardware.packets.framing import FRAMINGS, Framing

__all__ = ["Listener", "ScanStep", "baud_rates", "scan", "scan_rate"]

# What servos are delivered with, and what people set them to; the others follow from fast to slow.
_LIKELY = (1_000_000, 57_600, 115_200, 2_000_000, 3_000_000, 4_000_000, 500_000)


@dataclass(frozen=True, slots=True)
class ScanStep:
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


Listener = Callable[[ScanStep], None]
"""Who wants to know how far it is."""


def baud_rates(first: int | None = None) -> list[int]:
    """Return every rate that a known servo can be set to, the likely ones first.

    Args:
        first: A rate to begin with.
    """
    known = frozenset[int]().union(*(framing.baud_rates for framing in FRAMINGS))
    rates = [first] if first else []
    rates += [rate for rate in _LIKELY if rate in known]
    return list(dict.fromkeys([*rates, *sorted(known, reverse=True)]))


def scan(
    port: Port,
    rates: Iterable[int] | None = None,
    *,
    every: bool = False,
    on_step: Listener | None = None,
) -> list[Found]:
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
    found: list[Found] = []
    for rate in baud_rates() if rates is None else rates:
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
    on_step: Listener | None = None,
) -> list[Found]:
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
    speaking = [framing for framing in framings if _may_speak(framing, rate)]
    return [found for framing in speaking for found in _scan_framing(port, framing, on_step)]


def _may_speak(framing: Framing, rate: int) -> bool:
    """A rate that no table knows may be anybody's."""
    return rate in framing.baud_rates or not any(rate in f.baud_rates for f in FRAMINGS)


def _scan_framing(port: Port, framing: Framing, on_step: Listener | None) -> Iterator[Found]:
    def tell(count: int) -> None:
        if on_step:
            on_step(ScanStep(port.baudrate, framing.name, count, len(framing.ids)))

    heard = sweep(port, framing, framing.ids, tell)
    there = heard.suspects | heard.frames.keys()
    if there:  # somebody is on the line: who has not answered is asked once more
        rest = [servo_id for servo_id in framing.ids if servo_id not in there]
        there |= sweep(port, framing, rest, echoes=heard.echoes).frames.keys()
    for servo_id in sorted(there):
        found = look_closer(port, framing, servo_id, echoes=heard.echoes)
        if found:
            yield found
