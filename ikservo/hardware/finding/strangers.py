"""Who answers instead: servos that are silent may be there at another rate, id or protocol."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Generator, Iterable, Iterator, Sequence

from ikservo.errors import PortError, PortLostError, ServoSilentError
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.finding.identify import Found, look_closer
from ikservo.hardware.finding.scanning import baud_rates
from ikservo.hardware.finding.sweep import sweep
from ikservo.hardware.line.port import Port
from ikservo.hardware.packets.framing import FRAMINGS, Framing, framing_of
from ikservo.hardware.servo import ServoSpec

__all__ = ["naming_strangers", "strangers"]

_NOBODY = 251  # an id that nobody has: only an adapter that hears itself brings something for it
_NEW_IDS = (1,)  # as delivered
_ENOUGH = 3  # servos looked at closely; more would say the same


@contextlib.contextmanager
def naming_strangers(bus: ServoBus) -> Generator[None]:
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
            _advice(found, silent, bus.port.baudrate),
            servo=error.servo,
            servo_id=error.servo_id,
            port=error.port,
        ) from error


def strangers(port: Port, silent: Sequence[ServoSpec], known: Collection[int]) -> list[Found]:
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
        for other_rate in [rate, *(r for r in baud_rates() if r != rate)]:
            asked = ids if other_rate == rate else ids | set(_NEW_IDS)
            found = list(_answering(port, other_rate, asked))
            if found:
                return found
        return list(_answering(port, rate, set(range(_NOBODY)) - set(known)))
    finally:
        port.setBaudRate(rate)


def _answering(port: Port, rate: int, ids: Iterable[int]) -> Iterator[Found]:
    """Yield those of some ids who answer at a rate, in either framing."""
    if not _is_set(port, rate):
        return
    for framing in FRAMINGS:
        if rate in framing.baud_rates:
            yield from _answering_in(port, framing, sorted(ids))


def _answering_in(port: Port, framing: Framing, ids: Sequence[int]) -> Iterator[Found]:
    heard = sweep(port, framing, [*ids, _NOBODY])
    for servo_id in sorted(heard.suspects | heard.frames.keys() - {_NOBODY})[:_ENOUGH]:
        found = look_closer(port, framing, servo_id, echoes=heard.echoes)
        if found:
            yield found


def _is_set(port: Port, rate: int) -> bool:
    try:
        return port.setBaudRate(rate)
    except PortLostError:
        raise
    except PortError:  # the adapter cannot make this rate
        return False


def _advice(found: Sequence[Found], silent: Sequence[ServoSpec], rate: int) -> str:
    wanted = {framing_of(servo.table.family).name for servo in silent}
    if not wanted.intersection(one.protocol for one in found):
        return "If this is another arm, choose it with --arm. List all servos: ikservo scan"
    if all(one.baud_rate != rate for one in found):
        return "Set this rate: ikservo setup ARM. If this is another arm, choose it with --arm."
    return "Give each its own id: ikservo setup ARM. If this is another arm, choose it with --arm."
