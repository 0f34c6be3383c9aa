"""The lease of control: one operator at a time, who must be heard, and whose goals are not old."""

from __future__ import annotations

import math
import secrets
import threading
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass

from ikservo.clock import Clock
from ikservo.errors import LeaseLostError, RefusedError
from ikservo.guard import DEAD_MAN_TIMEOUT_S

IDLE_TIMEOUT_S = 3.0
"""An operator who moves nothing and is not heard for so long has lost the lease."""

_MAX_AHEAD_S = 0.3  # clocks that differ by more were not compared


@dataclass(frozen=True, slots=True)
class Holder:
    """Who controls an arm.

    Attributes:
        lease: Proves it in each message.
        operator: The name of the operator, for other people.
        since_s: Since when, by the clock of the server.
    """

    lease: str
    operator: str
    since_s: float


def is_fresh(sent_s: float, now_s: float, timeout_s: float = DEAD_MAN_TIMEOUT_S) -> bool:
    """Check whether a message counts: it is not old, and not from the future."""
    return -_MAX_AHEAD_S <= now_s - sent_s <= timeout_s


class ArmLease:
    """The lease of one arm; every method is safe in any thread.

    On the network messages of its holder are numbered and dated by the clock of the server. Those
    that are older than the dead-man timeout, repeated, or overtaken by later ones are dropped.

    Args:
        clock: The clock of the server.
        timeout_s: The time for which a message counts, and a motion goes on without another.

    Attributes:
        timeout_s: See above.
        dropped: The number of setpoints that were dropped.
    """

    def __init__(self, clock: Clock, timeout_s: float = DEAD_MAN_TIMEOUT_S) -> None:
        self._clock, self._lock, self.timeout_s = clock, threading.Lock(), timeout_s
        self._holder: Holder | None = None
        self._moving: Holder | None = None
        self._closed = False
        self._received_s = -math.inf
        self._setpoint_number = self._request_number = -1
        self.dropped = 0

    @property
    def holder(self) -> Holder | None:
        """Return who controls the arm; None where nobody does."""
        return self._holder

    @property
    def moving(self) -> Holder | None:
        """Return under whose lease a motion runs; None where none does."""
        return self._moving

    def is_held_by(self, lease: str) -> bool:
        """Check whether a lease is the present one."""
        holder = self._holder
        return holder is not None and holder.lease == lease

    @contextmanager
    def motion(self, lease: str) -> Generator[None]:
        """Mark a motion as running within the block: from now on its operator must be heard.

        Raises:
            LeaseLostError: It is requested under another lease than the present one.
        """
        with self._lock:
            if not self.is_held_by(lease):
                raise LeaseLostError
            self._moving = self._holder
        try:
            yield
        finally:
            self._moving = None

    def close(self) -> None:
        """Take the lease back for ever; a motion that runs under it is still in ``moving``."""
        with self._lock:
            self._holder, self._closed = None, True

    def acquire(self, operator: str, *, take_over: bool = False) -> Holder:
        """Give the lease to an operator.

        Args:
            operator: The name of the operator.
            take_over: Whether to take it from the one who has it, as pages of one person do.

        Raises:
            RefusedError: Another has it, or the lease was closed.
        """
        with self._lock:
            if self._closed:
                raise RefusedError("The program that serves the arm ends.", "Nothing was sent.")
            if self._holder is not None and not take_over:
                raise RefusedError(
                    f"{self._holder.operator} controls the arm.",
                    "Nothing was sent. It is free once that program has closed the arm.",
                )
            now_s = self._clock.now_s()
            self._holder = Holder(secrets.token_hex(16), operator, now_s)
            self._received_s = now_s
            self._setpoint_number = self._request_number = -1
            return self._holder

    def release(self, lease: str) -> bool:
        """Take the lease back; return whether it was this one."""
        with self._lock:
            if not self.is_held_by(lease):
                return False
            self._holder = None
            return True

    def refresh(self, lease: str) -> bool:
        """Note a sign of life of its holder; return whether it was the holder's."""
        with self._lock:
            if not self.is_held_by(lease):
                return False
            self._received_s = self._clock.now_s()
            return True

    def silence_s(self) -> float:
        """Return for how long no holder was heard; infinite before the first has the lease."""
        return self._clock.now_s() - self._received_s

    @property
    def is_silent(self) -> bool:
        """Whether no holder was heard for longer than the dead-man timeout."""
        return self.silence_s() > self.timeout_s

    def accept_setpoint(self, lease: str, number: int, sent_s: float) -> bool:
        """Check whether a setpoint counts: the holder's, newer than the last one, and not old."""
        with self._lock:
            if not (
                self.is_held_by(lease) and number > self._setpoint_number and self._is_fresh(sent_s)
            ):
                self.dropped += 1
                return False
            self._setpoint_number, self._received_s = number, self._clock.now_s()
            return True

    def check_request(self, lease: str, number: int, sent_s: float) -> None:
        """Refuse a request that is not the holder's, is repeated, or has come too late.

        Raises:
            RefusedError: It is refused; nothing has moved.
        """
        with self._lock:
            if not self.is_held_by(lease):
                raise LeaseLostError
            if number <= self._request_number:
                raise RefusedError("A request was repeated on its way.", "Nothing was sent.")
            if not self._is_fresh(sent_s):
                late_s = self._clock.now_s() - sent_s
                raise RefusedError(
                    f"A request came {late_s:.1f} s after it was made.",
                    "Nothing was sent. The network delays messages; try again.",
                )
            self._request_number, self._received_s = number, self._clock.now_s()

    def _is_fresh(self, sent_s: float) -> bool:
        return is_fresh(sent_s, self._clock.now_s(), self.timeout_s)
