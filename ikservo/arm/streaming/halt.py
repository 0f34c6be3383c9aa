"""The wish that a motion ends: said by a signal, another thread or a callback."""

from __future__ import annotations

from ikservo.errors import StoppedError

__all__ = ["CTRL_C", "STOPPED", "Halt"]

CTRL_C = "Stopped; the arm holds."
STOPPED = (CTRL_C, "Release it with: ikservo relax")


class Halt:
    """Remembers that somebody wants the arm to stop, and how often that was said.

    To ask is two assignments: a signal or another thread may do it at any time. Whoever streams
    goals looks at every beat.

    Attributes:
        times: How often a stop was asked for.
        heeded: Whether somebody streams, and so will see it at the next beat.
    """

    def __init__(self) -> None:
        self._reason = ""
        self.times = 0
        self.heeded = False

    def __bool__(self) -> bool:
        """Return whether somebody wants a stop."""
        return self.times > 0

    @property
    def reason(self) -> str:
        """Return why, as first said."""
        return self._reason

    def ask(self, reason: str) -> None:
        """Want the motion to end."""
        self._reason = self._reason or reason
        self.times += 1

    def heed(self) -> None:
        """Raise where somebody wants a stop.

        Raises:
            StoppedError: Somebody does; says why.
        """
        if self:
            raise StoppedError(self._reason or STOPPED[0], STOPPED[1])

    def clear(self) -> None:
        """Forget it: the arm stands, or somebody wants it to move again."""
        self._reason, self.times = "", 0
