"""How good a line is: many small reads, every one counted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import cycle, islice

from ikservo.errors import BusError
from ikservo.hardware.bus import ServoBus
from ikservo.registers import Role

__all__ = ["LineQuality", "probe"]


@dataclass(frozen=True, slots=True)
class LineQuality:
    """What became of many reads that were not repeated.

    Attributes:
        asked: How many reads.
        lost: How many brought no usable answer, by servo id.
        round_trips_s: How long each answered read took, in ascending order.
    """

    asked: int
    lost: dict[int, int]
    round_trips_s: tuple[float, ...]

    @property
    def lost_share(self) -> float:
        """Return lost reads over all reads."""
        return sum(self.lost.values()) / self.asked

    def round_trip_s(self, quantile: float) -> float:
        """Return the time that a share of the answered reads did not exceed."""
        last = len(self.round_trips_s) - 1
        return self.round_trips_s[min(int(quantile * (last + 1)), last)]


def probe(
    bus: ServoBus,
    servo_ids: Sequence[int],
    reads: int = 1000,
    on_read: Callable[[int], None] | None = None,
) -> LineQuality:
    """Read positions of servos in turn.

    Args:
        bus: The line; should not repeat questions, or repeats hide losses.
        servo_ids: Whom to ask.
        reads: How often.
        on_read: Called with the number of reads so far.

    Raises:
        PortLostError: The line is gone.
    """
    lost = dict.fromkeys(servo_ids, 0)
    took_s: list[float] = []
    for count, servo_id in enumerate(islice(cycle(servo_ids), reads), start=1):
        started_s = bus.clock.now_s()
        try:
            bus.read(servo_id, Role.PRESENT_POSITION, raw=True)
            took_s.append(bus.clock.now_s() - started_s)
        except BusError:
            lost[servo_id] += 1
        if on_read:
            on_read(count)
    return LineQuality(reads, {i: n for i, n in lost.items() if n}, tuple(sorted(took_s)))
