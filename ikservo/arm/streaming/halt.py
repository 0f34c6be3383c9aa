"""The request that a motion ends: made by a signal, another thread or a callback."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager

from ikservo.errors import StoppedError
from ikservo.guard import StopKind, StopReason

__all__ = [
    "CTRL_C",
    "RELAX_HINT",
    "STOPPED_BY_PROGRAM",
    "StopKind",
    "StopReason",
    "StopRequest",
]

CTRL_C = StopReason(StopKind.CTRL_C, "Stopped; torque stays on.")
STOPPED_BY_PROGRAM = StopReason(StopKind.PROGRAM, "Stopped; torque stays on.")
RELAX_HINT = "Switch torque off with: ikservo relax"


class StopRequest:
    """Remembers that the arm shall stop, why, and how often that was requested.

    To set it is a few assignments: a signal or another thread may do it at any time. The control
    loop looks at it in every cycle.

    Attributes:
        times: How often a stop was requested.
        acknowledged: Whether the stop was acknowledged before the motion that it ends has ended.
        signal: The signal that requested first; 0 where none did.
    """

    def __init__(self) -> None:
        self._reason: StopReason | None = None
        self.times = self.signal = 0
        self.acknowledged = self._motion_running = False
        self._without_braking, self._hint = False, RELAX_HINT

    def __bool__(self) -> bool:
        """Return whether a stop was requested."""
        return self.times > 0

    @property
    def reason(self) -> StopReason | None:
        """Why, as first requested; None where no stop was."""
        return self._reason

    @property
    def motion_running(self) -> bool:
        """Whether a motion runs, of one control loop or several: see ``motion``."""
        return self._motion_running

    def set(self, reason: StopReason, signal: int = 0) -> None:
        """Request that the motion ends; says which signal requests it, if one does."""
        self.signal = self.signal or signal
        self._reason = self._reason or reason
        self.acknowledged = False
        self.times += 1

    def set_without_braking(self, reason: StopReason, hint: str) -> None:
        """Request that the motion ends at once: nothing more can or shall be sent."""
        self._without_braking, self._hint = True, hint
        self.set(reason)

    @contextmanager
    def motion(self) -> Generator[None]:
        """Note that a motion runs while the block does: a stop of it cannot be taken back."""
        before, self._motion_running = self._motion_running, True
        try:
            yield
        finally:
            self._motion_running = before

    def raise_if_without_braking(self) -> None:
        """Raise where the motion must end without braking.

        Raises:
            StoppedError: It must; says why.
        """
        if self._without_braking:
            self.raise_if_set()

    def raise_if_set(self) -> None:
        """Raise where a stop was requested.

        Raises:
            StoppedError: It was; says why.
        """
        if self:
            raise StoppedError((self._reason or STOPPED_BY_PROGRAM).text, self._hint)

    def clear(self) -> None:
        """Forget it: the arm holds, or shall be moved again."""
        self._reason, self.times, self.signal = None, 0, 0
        self._without_braking, self._hint, self.acknowledged = False, RELAX_HINT, False
