"""Questions that every servo must answer: put again, with pauses, until all have."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TypeVar

from ikservo.clock import Clock
from ikservo.errors import BusError
from ikservo.hardware.bus import ServoBus
from ikservo.registers import Register, Role

__all__ = ["ask_all", "ask_each", "patiently"]

_ATTEMPTS = 4
# A busy machine, or an adapter that hiccups, is given this much more time after each attempt.
_PAUSE_S = 0.02

_Key = TypeVar("_Key", bound=Register | Role)


def ask_all(bus: ServoBus, servo_ids: Iterable[int], wanted: Role) -> dict[int, int]:
    """Return a raw register of every servo.

    Raises:
        BusError: A servo does not answer, however often it is asked; names all such.
    """
    rows = ask_each(bus, dict.fromkeys(servo_ids, (wanted,)))
    return {servo_id: row[wanted] for servo_id, row in rows.items()}


def ask_each(bus: ServoBus, wanted: Mapping[int, Sequence[_Key]]) -> dict[int, Mapping[_Key, int]]:
    """Return of each servo its own raw registers.

    Raises:
        BusError: A servo does not answer, however often it is asked; names all such.
    """
    known: dict[int, Mapping[_Key, int]] = {}
    for attempt in range(1, _ATTEMPTS + 1):
        missing = {i: keys for i, keys in wanted.items() if i not in known}
        readings = bus.bulk_read(missing, raw=True)
        known |= readings.values
        if not readings.errors:
            break
        if attempt == _ATTEMPTS:
            readings.complete()
        bus.clock.sleep_until(bus.clock.now_s() + _PAUSE_S * attempt)
    return known


def patiently(clock: Clock, settle: Callable[[], None]) -> None:
    """Settle something with a servo at rest; where it fails it is tried again after a pause.

    Raises:
        BusError: However often that was tried.
    """
    for attempt in range(1, _ATTEMPTS):
        try:
            return settle()
        except BusError:
            clock.sleep_until(clock.now_s() + _PAUSE_S * attempt)
    return settle()
