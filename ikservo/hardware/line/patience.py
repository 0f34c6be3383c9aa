"""How long an answer may take beyond its time on the wire."""

from __future__ import annotations

__all__ = ["Patience"]

_LEARNED = 16  # answers before their times are trusted
_REMEMBERED = 32  # answers of late, and as many before them, whose slowest counts
_MARGIN = 1.5  # times the slowest answer of late
_MOST_DOUBLINGS = 6
_OWN_FAULT = 2  # silences in a row that are rather a servo's than the adapter's


class Patience:
    """Learns from the answers that came how long to wait for one that may not come.

    USB adapters hold bytes back for 1 to 16 ms and every one differs, so the wait starts long
    and shrinks to a multiple of the slowest recent answer. It grows again while nobody answers.
    """

    def __init__(self, least_s: float, most_s: float) -> None:
        self.least_s, self.most_s = least_s, most_s
        self._learned = self._silences = 0
        self._slowest_s = self._slowest_before_s = 0.0

    @property
    def usual_s(self) -> float:
        """Return within what time beyond wire time and return delays answers came of late."""
        if self._learned < _LEARNED:
            return self.most_s
        return min(max(self._slowest_s, self._slowest_before_s), self.most_s)

    @property
    def allowance_s(self) -> float:
        """Return how long to wait beyond wire time and return delays, seconds."""
        if self._learned < _LEARNED:
            return self.most_s
        learned_s = max(self.least_s, _MARGIN * self.usual_s)
        factor = 2.0 ** min(max(self._silences - _OWN_FAULT, 0), _MOST_DOUBLINGS)
        return min(learned_s * factor, self.most_s)

    def learn(self, overhead_s: float) -> None:
        """Remember by how much an answer exceeded its time on the wire."""
        self._silences = 0
        self._learned += 1
        if self._learned % _REMEMBERED == 0:
            self._slowest_before_s, self._slowest_s = self._slowest_s, overhead_s
        elif overhead_s > self._slowest_s:
            self._slowest_s = overhead_s

    def miss(self, *, many: bool = False) -> None:
        """Wait twice as long, from the third time in a row on which nobody answers at all.

        Args:
            many: Several were asked: that is the adapter, or this machine, and four times as
                long is waited at once.
        """
        self._silences = max(self._silences + 1, _OWN_FAULT + 2 if many else 0)

    def insist(self) -> None:
        """Wait for the next answer as long as for any: who is asked alone has earned it."""
        self._silences = _OWN_FAULT + _MOST_DOUBLINGS
