"""The stop of an arm: its reason, and the latch that refuses motions until it is acknowledged."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto

from ikservo.errors import LatchedStopError


class StopKind(Enum):
    """The kind of reason for a stop; control flow depends only on this."""

    CTRL_C = auto()
    """SIGINT, or ``KeyboardInterrupt`` in a callback."""
    TERMINATED = auto()
    """SIGTERM."""
    HANGUP = auto()
    """SIGHUP: the terminal was closed."""
    PROGRAM = auto()
    """``Arm.stop`` in the program that moves the arm."""
    CANCELLED = auto()
    """``Motion.cancel`` in the program that moves the arm."""
    CLIENT = auto()
    """Another terminal, or the web page."""
    CLOSED = auto()
    """The arm, or the motion's owner, was closed during a motion."""
    RELEASED = auto()
    """Torque was switched off."""
    UNPLUGGED = auto()
    """The port was lost."""
    OBSTACLE = auto()
    """Something entered the path of a motion."""
    FAULT = auto()
    """An error ended the motion."""


@dataclass(frozen=True, slots=True)
class StopReason:
    """The reason why an arm was stopped.

    Attributes:
        kind: The kind of reason, for programs.
        text: The text for the user; the lines after the first give details.
    """

    kind: StopKind
    text: str = ""

    @property
    def headline(self) -> str:
        """The first line of the text."""
        return self.text.splitlines()[0] if self.text else "no reason was given"


class StopLatch:
    """Reason for a stop, held until the stop is acknowledged.

    Latching a stop is one assignment, so a signal or another thread may do it at any time.

    Attributes:
        reason: The reason for the stop; None if the arm is not stopped.
    """

    def __init__(self) -> None:
        self.reason: StopReason | None = None

    def latch_stop(self, reason: StopReason) -> None:
        """Latch a stop for a reason; the first reason is kept, because it causes the others."""
        self.reason = self.reason or reason

    def acknowledge(self) -> StopReason | None:
        """Clear the stop and return its reason."""
        reason, self.reason = self.reason, None
        return reason

    def raise_if_stopped(self) -> None:
        """Raise an error if a stop is latched.

        Raises:
            LatchedStopError: The arm was stopped; the error has the reason.
        """
        if self.reason is not None:
            raise LatchedStopError(self.reason.headline)
