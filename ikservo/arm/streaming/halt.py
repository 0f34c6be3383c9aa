"""The wish that a motion ends: said by a signal, another thread or a callback."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager

from ikservo.errors import StoppedError

__all__ = ["CTRL_C", "STOPPED", "Halt"]

CTRL_C = "Stopped; torque stays on."
STOPPED = (CTRL_C, "Switch torque off with: ikservo relax")


class Halt:
    """Remembers that somebody wants the arm to stop, and how often that was said.

    To ask is two assignments: a signal or another thread may do it at any time. Whoever streams
    goals looks at every beat.

    Attributes:
        times: How often a stop was asked for.
        heeded: Whether somebody streams, and so will see it at the next beat.
        running: Whether a motion runs, of one stream or several.
        acknowledged: Whether the stop was acknowledged before the motion that it ends has ended.
        signal: The signal that asked first; 0 where none did.
    """

    def __init__(self) -> None:
        self._reason = ""
        self.times = self.signal = 0
        self.heeded = self.running = self.acknowledged = False
        self._at_once, self._hint = False, STOPPED[1]

    def __bool__(self) -> bool:
        """Return whether somebody wants a stop."""
        return self.times > 0

    @property
    def reason(self) -> str:
        """Return why, as first said."""
        return self._reason

    def ask(self, reason: str, signal: int = 0) -> None:
        """Want the motion to end; says which signal asks, if one does."""
        self.signal = self.signal or signal
        self._reason = self._reason or reason
        self.acknowledged = False
        self.times += 1

    def ask_at_once(self, reason: str, hint: str) -> None:
        """Want the motion to end without braking: nothing more can or shall be sent."""
        self._at_once, self._hint = True, hint
        self.ask(reason)

    @contextmanager
    def motion(self) -> Generator[None]:
        """Note that a motion runs while the block does: a stop of it cannot be taken back."""
        before, self.running = self.running, True
        try:
            yield
        finally:
            self.running = before

    def heed_at_once(self) -> None:
        """Raise where the motion must end without braking.

        Raises:
            StoppedError: It must; says why.
        """
        if self._at_once:
            self.heed()

    def heed(self) -> None:
        """Raise where somebody wants a stop.

        Raises:
            StoppedError: Somebody does; says why.
        """
        if self:
            raise StoppedError(self._reason or STOPPED[0], self._hint)

    def clear(self) -> None:
        """Forget it: the arm stands, or somebody wants it to move again."""
        self._reason, self.times, self.signal = "", 0, 0
        self._at_once, self._hint, self.acknowledged = False, STOPPED[1], False
