"""The stop that stays: an arm that was stopped is not moved again until a user acknowledges it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto

from ikservo.errors import RefusedError

__all__ = ["Latch", "StopKind", "StopReason"]


class StopKind(Enum):
    """Why an arm was stopped, for programs: control flow looks at nothing else."""

    CTRL_C = auto()
    """SIGINT, or ``KeyboardInterrupt`` in a callback."""
    TERMINATED = auto()
    """SIGTERM."""
    HANGUP = auto()
    """SIGHUP: the terminal was closed."""
    PROGRAM = auto()
    """``Arm.stop`` of the program that moves the arm."""
    CANCELLED = auto()
    """``Motion.cancel``."""
    CLIENT = auto()
    """Another terminal, or the page."""
    CLOSED = auto()
    """The arm, or what moves it, was closed during a motion."""
    RELEASED = auto()
    """Torque was switched off."""
    UNPLUGGED = auto()
    """The line was lost."""
    FAULT = auto()
    """An error ended the motion."""


@dataclass(frozen=True, slots=True)
class StopReason:
    """Why an arm was stopped.

    Attributes:
        kind: For programs.
        text: For the user; lines after the first are details.
    """

    kind: StopKind
    text: str = ""

    @property
    def headline(self) -> str:
        """The first line of the text."""
        return self.text.splitlines()[0] if self.text else "no reason was given"


class Latch:
    """Remembers why the arm was stopped, until somebody acknowledges it.

    To latch a stop is one assignment, so that a signal or another thread may do it at any time.
    """

    def __init__(self) -> None:
        self._reason: StopReason | None = None

    @property
    def reason(self) -> StopReason | None:
        """Why the arm was stopped; None where it is not."""
        return self._reason

    def latch_stop(self, reason: StopReason) -> None:
        """Stop for a reason; the first one stays, for it is the cause of the others."""
        self._reason = self._reason or reason

    def acknowledge(self) -> StopReason | None:
        """Let the arm be moved again, and return what it was stopped for."""
        reason, self._reason = self._reason, None
        return reason

    def check(self) -> None:
        """Raise while the stop stays.

        Raises:
            RefusedError: The arm was stopped; says why.
        """
        if self._reason is not None:
            raise RefusedError(
                f"The arm was stopped: {self._reason.headline}",
                "Check the arm, then acknowledge the stop.",
            )
