"""Waiting for a person: a servo is plugged in, or pulled out again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import count

from ikservo.errors import ServoSilentError
from ikservo.hardware.finding.identify import Found, look_closer
from ikservo.hardware.finding.scanning import scan_rate
from ikservo.hardware.line.port import Port
from ikservo.hardware.packets.framing import framing_of
from ikservo.registers import ServoTable

__all__ = ["await_none", "await_one"]

_FACTORY_RATES = (1_000_000, 57_600)  # Feetech's and ROBOTIS'
_EVERY = 4  # looks, after which all rates are tried
_PAUSE_S = 0.1

Tell = Callable[[Sequence[Found]], None]


def await_one(port: Port, table: type[ServoTable], rate: int, wait_s: float, tell: Tell) -> Found:
    """Return the one servo that answers, once the same has answered twice in a row.

    While several answer, which two servos at one id do as well, it goes on waiting.

    Args:
        port: The line.
        table: What is expected; only its framing is tried.
        rate: At which it may answer already, besides those of a new servo.
        wait_s: How long to wait.
        tell: Told who answers each time that changes.

    Raises:
        ServoSilentError: Nobody came, or several stayed.
        PortLostError: The line is gone.
    """
    before: list[Found] = []
    give_up_s = port.clock.now_s() + wait_s
    for look in count():
        found = _look(port, table, _rates(table, rate, every=look % _EVERY == _EVERY - 1))
        if _places(found) != _places(before):
            tell(found)
        if len(found) == 1 and not found[0].crowded and _places(found) == _places(before):
            return found[0]
        if port.clock.now_s() > give_up_s:
            raise _vain(port, found, wait_s)
        before = found
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
            still = f"still brings answers from id {found.id} after {wait_s:.0f} s"
            raise ServoSilentError(still, "Pull out the servo that is done.", port=port.name)
        _rest(port)


def _look(port: Port, table: type[ServoTable], rates: Sequence[int]) -> list[Found]:
    framing = framing_of(table.family)
    found: list[Found] = []
    for rate in rates:
        found += scan_rate(port, rate, [framing])
    return found


def _rates(table: type[ServoTable], rate: int, *, every: bool) -> list[int]:
    known = set(table.baud_rates.values())
    likely = [r for r in (rate, *_FACTORY_RATES) if r in known or r == rate]
    return list(dict.fromkeys([*likely, *(sorted(known, reverse=True) if every else ())]))


def _places(found: Sequence[Found]) -> list[tuple[int, int, bool]]:
    return [(servo.id, servo.baud_rate, servo.crowded) for servo in found]


def _vain(port: Port, found: Sequence[Found], wait_s: float) -> ServoSilentError:
    if not found:
        return ServoSilentError(f"brings no servo within {wait_s:.0f} s", port=port.name)
    what = "several servos at one id" if len(found) == 1 else f"{len(found)} servos"
    hint = "Leave only one plugged in: the others would be changed with it."
    return ServoSilentError(
        f"brings {what} instead of one, for {wait_s:.0f} s", hint, port=port.name
    )


def _rest(port: Port) -> None:
    port.clock.sleep_until(port.clock.now_s() + _PAUSE_S)
