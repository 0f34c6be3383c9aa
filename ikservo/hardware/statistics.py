"""How well each servo answers: counts and round trips."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from ikservo.hardware.packets.replies import Fault, FaultKind, Reply

__all__ = ["ServoStatistics"]


@dataclass(slots=True)
class ServoStatistics:
    """What happened to the questions put to one servo.

    Attributes:
        asked: Questions, repeats included.
        lost: Questions without an answer.
        garbled: Questions whose answer was unusable.
        refused: Questions the servo answered with no.
        retried: Questions put again.
        lost_in_a_row: Questions without a usable answer since the last good one.
        round_trips_s: How long the latest answers took, seconds; a group's answers count as one.
    """

    asked: int = 0
    lost: int = 0
    garbled: int = 0
    refused: int = 0
    retried: int = 0
    lost_in_a_row: int = 0
    round_trips_s: deque[float] = field(default_factory=lambda: deque[float](maxlen=1000))

    def note(self, reply: Reply, took_s: float) -> None:
        """Count one question and what came of it."""
        self.asked += 1
        if isinstance(reply, Fault):
            self.lost += reply.kind is FaultKind.SILENT
            self.garbled += reply.kind is FaultKind.GARBLED
            self.refused += reply.kind is FaultKind.REFUSED
            if reply.kind is not FaultKind.REFUSED:
                self.lost_in_a_row += 1
                return
        self.lost_in_a_row = 0
        self.round_trips_s.append(took_s)

    def round_trip_s(self, quantile: float) -> float | None:
        """Return the round trip that a share of the latest answers did not exceed."""
        ordered = sorted(self.round_trips_s)
        return ordered[min(int(quantile * len(ordered)), len(ordered) - 1)] if ordered else None
