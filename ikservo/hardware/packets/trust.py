"""How far a line can be believed: damaged, doubled and stray packets are remembered for a while."""

from __future__ import annotations

__all__ = ["Pace", "Trust"]

_AT_FIRST, _PER_EVENT, _MOST = 50, 300, 3000  # clean questions that it takes to be believed

_LEARNED = 16  # answers that came no sooner than the wire allows
_SLACK = 1.03  # clocks of servos and adapters differ by this much at most


class Trust:
    """A line is believed once it has been clean for a while; anything odd costs it that.

    Args:
        doubts: How many clean questions it takes until the line is believed.

    Attributes:
        wary: The line is not believed yet, or not any more: what does not change by itself is
            read twice.
        sick: Something odd came of late: besides, nothing is asked twice in the same shape.
    """

    def __init__(self, doubts: int = _AT_FIRST) -> None:
        self._doubts = doubts
        self.wary, self.sick = doubts > 0, False

    def note(self, *, odd: bool) -> None:
        """Count one question: whether something came that should not have."""
        if odd:
            self._doubts = min(self._doubts + _PER_EVENT, _MOST)
            self.wary = self.sick = True
        elif self.wary:
            self._doubts -= 1
            self.wary = self._doubts > 0
            self.sick = self.sick and self.wary


class Pace:
    """Knows how many bytes of an answer can have come so far; any more are older than the question.

    Some lines are faster than their baud rate says (a socket, a bridge, a pseudo-terminal), so
    the limit counts only once answers have kept to it for a while, and no longer when keeping to
    it has cost an answer.
    """

    def __init__(self) -> None:
        self._kept = 0

    def stale(self, count: int, since_s: float, byte_s: float) -> int:
        """Return how many of the bytes heard are older than the question.

        Args:
            count: Bytes heard.
            since_s: Time since the question's last byte left.
            byte_s: Time of a byte on the wire.
        """
        if self._kept < _LEARNED:
            return 0
        return max(0, count - int(since_s / byte_s * _SLACK + 1))

    def learn(self, count: int, since_s: float, byte_s: float) -> None:
        """Remember whether a whole answer came no sooner than it could."""
        self._kept = self._kept + 1 if count <= since_s / byte_s * _SLACK + 1 else 0

    def mistrust(self) -> None:
        """Forget everything: bytes were called stale and then no answer came."""
        self._kept = 0
