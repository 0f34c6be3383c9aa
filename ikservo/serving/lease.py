"""The control lease: one operator at a time has it, and must send messages regularly."""

from __future__ import annotations

import math
import secrets
import threading
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass

from ikservo.clock import Clock
from ikservo.errors import LeaseLostError, RefusedError
from ikservo.guard.dead_man import DEAD_MAN_TIMEOUT_S

IDLE_TIMEOUT_S = 3.0
"""Time after which a silent operator who moves nothing loses the lease [s]."""

_MAX_AHEAD_S = 0.3  # a message further ahead means that the clocks were not compared


@dataclass(frozen=True, slots=True)
class Holder:
    """The operator who controls an arm: lease, name, and start of control by the server's clock."""

    lease: str
    operator: str
    since_s: float


def is_fresh(sent_s: float, now_s: float, timeout_s: float = DEAD_MAN_TIMEOUT_S) -> bool:
    """Check whether a message is valid: neither too old nor from the future."""
    return -_MAX_AHEAD_S <= now_s - sent_s <= timeout_s


class ArmLease:
    """The lease of one arm; every method is safe in any thread.

    On the network, messages from its holder have numbers and time stamps by the server's clock.
    Messages that are older than the dead-man time-out, repeated, or overtaken are dropped.

    Args:
        clock: The clock of the server.
        timeout_s: The time for which a message is valid and keeps a motion running.

    Attributes:
        holder: The operator who controls the arm; None if nobody does.
        moving: The holder under whose lease a motion is running; None if no motion is running.
        dropped: The number of setpoints that were dropped.
    """

    def __init__(self, clock: Clock, timeout_s: float = DEAD_MAN_TIMEOUT_S) -> None:
        self._clock, self._lock, self.timeout_s = clock, threading.Lock(), timeout_s
        self.holder: Holder | None = None
        self.moving: Holder | None = None
        self._closed = False
        self._received_s = -math.inf
        self._setpoint_number = self._request_number = -1
        self.dropped = 0

    def is_held_by(self, lease: str) -> bool:
        """Check whether a lease is the current lease."""
        holder = self.holder
        return holder is not None and holder.lease == lease

    @contextmanager
    def motion(self, lease: str) -> Generator[None]:
        """Mark a motion as running in the ``with`` block; its operator must then send messages.

        Raises:
            LeaseLostError: The motion is requested under a lease that is no longer valid.
        """
        with self._lock:
            if not self.is_held_by(lease):
                raise LeaseLostError
            self.moving = self.holder
        try:
            yield
        finally:
            self.moving = None

    def close(self) -> None:
        """Withdraw the lease permanently; a motion that runs under it stays in ``moving``."""
        with self._lock:
            self.holder, self._closed = None, True

    def acquire(self, operator: str, *, take_over: bool = False) -> Holder:
        """Give the lease to an operator.

        With ``take_over``, the lease is taken from its holder; pages of the same user do this.

        Raises:
            RefusedError: Another operator controls the arm, or the lease was closed.
        """
        with self._lock:
            if self._closed:
                raise RefusedError(
                    "The program that controls the arm is ending.", "Nothing was sent."
                )
            if self.holder is not None and not take_over:
                hint = "Nothing was sent. The arm is free once that program has closed it."
                raise RefusedError(f"{self.holder.operator} controls the arm.", hint)
            now_s = self._clock.now_s()
            self.holder = Holder(secrets.token_hex(16), operator, now_s)
            self._received_s = now_s
            self._setpoint_number = self._request_number = -1
            return self.holder

    def release(self, lease: str) -> bool:
        """End the lease; return whether the given lease was valid."""
        with self._lock:
            if not self.is_held_by(lease):
                return False
            self.holder = None
            return True

    def refresh(self, lease: str) -> bool:
        """Record a message from the holder; return whether ``lease`` is valid."""
        with self._lock:
            if not self.is_held_by(lease):
                return False
            self._received_s = self._clock.now_s()
            return True

    def silence_s(self) -> float:
        """Return the time without a message from the holder; infinite before the first holder."""
        return self._clock.now_s() - self._received_s

    @property
    def is_silent(self) -> bool:
        """Whether the holder has been silent for longer than the dead-man time-out."""
        return self.silence_s() > self.timeout_s

    def accept_setpoint(self, lease: str, number: int, sent_s: float) -> bool:
        """Check whether a setpoint is from the holder, newer than the last one, and not too old."""
        with self._lock:
            if not (
                self.is_held_by(lease) and number > self._setpoint_number and self._is_fresh(sent_s)
            ):
                self.dropped += 1
                return False
            self._setpoint_number, self._received_s = number, self._clock.now_s()
            return True

    def check_request(self, lease: str, number: int, sent_s: float) -> None:
        """Refuse a request that is not from the holder, is repeated, or arrives too late.

        Raises:
            RefusedError: The request is refused; nothing has moved.
        """
        with self._lock:
            if not self.is_held_by(lease):
                raise LeaseLostError
            if number <= self._request_number:
                raise RefusedError("The network repeated a request.", "The arm ignored it.")
            if not self._is_fresh(sent_s):
                late_s = self._clock.now_s() - sent_s
                hint = "The arm ignored it. The network is slow; try again."
                raise RefusedError(f"A request arrived {late_s:.1f} s after it was sent.", hint)
            self._request_number, self._received_s = number, self._clock.now_s()

    def _is_fresh(self, sent_s: float) -> bool:
        return is_fresh(sent_s, self._clock.now_s(), self.timeout_s)
