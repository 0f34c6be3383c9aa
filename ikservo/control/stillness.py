"""Detect that joints are at rest, from their positions over a window of time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

from ikservo.clock import Clock

_WINDOW_S = 0.5  # a hand that pauses for a shorter time has not let go
_NOISE_TICKS = 4  # noise of the encoders at rest
_READINGS = 3  # two readings of a hand that moves may agree by chance


@dataclass(frozen=True, slots=True)
class StillnessDetector:
    """Detector of rest from recent positions by servo or joint: unwrapped ticks, rad or m.

    Attributes:
        window_s: Time during which nothing may move.
        tolerance: The maximum variation of positions that counts as rest.
        least_readings: Minimum number of readings before rest can be detected.
        readings: Times and positions within the window, and the last reading before the window.
    """

    window_s: float = _WINDOW_S
    tolerance: float = _NOISE_TICKS
    least_readings: int = _READINGS
    readings: tuple[tuple[float, Mapping[int, float]], ...] = ()

    def add_reading(self, at_s: float, positions: Mapping[int, float]) -> StillnessDetector:
        """Add a reading and drop outdated readings."""
        start_s = at_s - self.window_s
        recent = [row for row in self.readings if row[0] > start_s]
        before = [row for row in self.readings if row[0] <= start_s][-1:]
        return replace(self, readings=(*before, *recent, (at_s, positions)))

    def add_joints(self, at_s: float, joints: Iterable[float]) -> StillnessDetector:
        """Add a reading of all joints (n,)."""
        return self.add_reading(at_s, dict(enumerate(joints)))

    @property
    def joints(self) -> list[float]:
        """The last positions (n,)."""
        return list(self.readings[-1][1].values())

    def restarted(self) -> StillnessDetector:
        """Return a detector without readings."""
        return replace(self, readings=())

    def is_at_rest(self) -> bool:
        """Check whether nothing has moved within the window."""
        if len(self.readings) < self.least_readings:
            return False
        span_s = self.readings[-1][0] - self.readings[0][0] + 1e-9  # sums of times are rounded
        return span_s >= self.window_s and not self.has_moved()

    def has_moved(self) -> bool:
        """Check whether something has moved since the first reading of the window."""
        return max(self.variations(), default=0.0) > self.tolerance

    def variations(self) -> list[float]:
        """Compute the variation of each position over the window."""
        return [max(column) - min(column) for column in self._columns()]

    def mean_ticks(self) -> dict[int, float]:
        """Compute the mean position of each servo over the window."""
        means = (sum(column) / len(column) for column in self._columns())
        return dict(zip(self.readings[-1][1], means, strict=True))

    def _columns(self) -> list[list[float]]:
        return [[positions[i] for _, positions in self.readings] for i in self.readings[-1][1]]


def read_until_at_rest(
    detector: StillnessDetector,
    read: Callable[[], Iterable[float]],
    clock: Clock,
    timeout_s: float,
    ends: Callable[[StillnessDetector], bool] = StillnessDetector.is_at_rest,
) -> StillnessDetector:
    """Read joints (n,) until nothing has moved within the detector's window or time is up.

    The readings that the detector needs are spread evenly over its window.
    """
    end_s = clock.now_s() + timeout_s
    while True:
        detector = detector.add_joints(clock.now_s(), read())
        if ends(detector) or clock.now_s() >= end_s:
            return detector
        clock.sleep_until(clock.now_s() + detector.window_s / (detector.least_readings - 1))
