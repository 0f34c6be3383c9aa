"""Starts motions of one arm in the background, and ends them when the arm is closed."""

from __future__ import annotations

import atexit
import threading
import weakref
from collections.abc import Callable
from typing import TypeVar

from ikservo.arm.background.motion import Motion, Stoppable
from ikservo.arm.streaming.halt import StopRequest
from ikservo.arm.streaming.signals import stop_on_signals
from ikservo.errors import RefusedError

__all__ = ["Background"]

T = TypeVar("T")

_running: weakref.WeakSet[Motion[object]] = weakref.WeakSet()


class Background:
    """The motions of one arm, one after the other.

    Args:
        arm: Whose motions they are.
        stop_request: Requests that the running motion ends, for signals.
    """

    def __init__(self, arm: Stoppable, stop_request: StopRequest) -> None:
        self._arm, self._stop_request = arm, stop_request
        self._queue = threading.RLock()
        self._motions: list[Motion[object]] = []
        self._stream: Motion[object] | None = None

    def do(self, work: Callable[[], T]) -> T:
        """Plan and move in this thread, once the motions before are over.

        Raises:
            RefusedError: A stream of setpoints is open.
        """
        self._check_no_stream()
        with self._queue:
            return work()

    def start(self, work: Callable[[], T]) -> Motion[T]:
        """Begin a motion in a thread of its own, once those before are over; never waits.

        Raises:
            RefusedError: A stream of setpoints is open.
        """
        self._check_no_stream()
        return self._started(work)

    def start_stream(self, work: Callable[[], T]) -> Motion[T]:
        """Begin a stream of setpoints; other motions are refused until it has ended.

        Raises:
            RefusedError: Another one is open.
        """
        self._check_no_stream()
        motion = self._started(work)
        self._stream = motion  # pyright: ignore[reportAttributeAccessIssue]  # of whatever result
        return motion

    def close(self) -> None:
        """Cancel what still runs or waits, and return once it is over."""
        for motion in self._motions:
            motion.cancel()
        for motion in self._motions:
            motion.join()

    def _started(self, work: Callable[[], T]) -> Motion[T]:
        motion = Motion(work, self._arm, self._queue)
        self._motions = [each for each in self._motions if not each.done]
        self._motions.append(motion)  # pyright: ignore[reportArgumentType]  # of whatever result
        _running.add(motion)  # pyright: ignore[reportArgumentType]
        stop_on_signals(self._stop_request, lambda: not motion.done)
        motion.start()
        return motion

    def _check_no_stream(self) -> None:
        if self._stream is not None and not self._stream.done:
            raise RefusedError(
                "A stream of setpoints is open.", "Leave its block first, or send goals through it."
            )


def _cancel_all() -> None:
    """Brake what still runs when the program ends; its threads would die in mid-motion."""
    motions = list(_running)
    for motion in motions:
        motion.cancel()
    for motion in motions:
        motion.join(1.0)


atexit.register(_cancel_all)
