"""Servos that have fallen silent: asked seldom, so that they cost the others no time."""

from __future__ import annotations

from ikservo.clock import Clock
from ikservo.hardware.packets.replies import Fault, FaultKind, Reply

__all__ = ["Absence"]

_DEAF_AFTER = 3  # losses in a row
_PROBE_EVERY_S = 0.25


class Absence:
    """Decides whether a servo in a group is worth a question now.

    A servo that has lost three answers in a row is asked again every quarter of a second, until
    it answers; in between it has the fault of the last time.
    """

    def __init__(self) -> None:
        self._lost: dict[int, int] = {}
        self._last: dict[int, Fault] = {}
        self._asked_s: dict[int, float] = {}

    def __bool__(self) -> bool:
        """Return whether anybody has lost an answer of late."""
        return bool(self._lost)

    def excused(self, servo_id: int, now_s: float) -> Fault | None:
        """Return the fault of a servo that need not be asked now, or None if it is to be asked."""
        if not self._lost or self._lost.get(servo_id, 0) < _DEAF_AFTER:
            return None
        if now_s - self._asked_s[servo_id] >= _PROBE_EVERY_S:
            return None
        return self._last[servo_id]

    def is_deaf(self, servo_id: int) -> bool:
        """Return whether it has been silent for so long that a repeat is a waste of time."""
        return bool(self._lost) and self._lost.get(servo_id, 0) >= _DEAF_AFTER

    def note(self, reply: Reply, clock: Clock) -> None:
        """Remember whether a servo answered."""
        if isinstance(reply, Fault) and reply.kind is not FaultKind.REFUSED:
            self._lost[reply.servo_id] = self._lost.get(reply.servo_id, 0) + 1
            self._last[reply.servo_id], self._asked_s[reply.servo_id] = reply, clock.now_s()
        elif self._lost:
            self._lost.pop(reply.servo_id, None)
