"""The stop that stays: what was stopped for a reason is not moved again until a person says so."""

from __future__ import annotations

from ikservo.errors import RefusedError

__all__ = ["Latch"]


class Latch:
    """Remembers why the arm was stopped, until somebody acknowledges it.

    To trip it is one assignment, so that a signal or another thread may do it at any time.
    """

    def __init__(self) -> None:
        self._reason = ""

    @property
    def reason(self) -> str:
        """Return why the arm was stopped; empty where it is not."""
        return self._reason

    def trip(self, reason: str) -> None:
        """Stop for a reason; the first one stays, for it is the cause of the others."""
        self._reason = self._reason or reason or "The arm was stopped."

    def acknowledge(self) -> str:
        """Let the arm be moved again, and return what it was stopped for."""
        reason, self._reason = self._reason, ""
        return reason

    def check(self) -> None:
        """Raise while the stop stays.

        Raises:
            RefusedError: The arm was stopped; says why.
        """
        if self._reason:
            raise RefusedError(
                f"The arm was stopped: {self._reason.splitlines()[0]}",
                "Check the arm, then acknowledge the stop.",
            )
