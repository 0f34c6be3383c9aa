"""Motions in a background thread: a handle to wait for or cancel a motion, and their runner."""

from __future__ import annotations

import atexit
import logging
import math
import os
import threading
import time
import weakref
from collections.abc import Callable, Generator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from typing import Generic, ParamSpec, Protocol, TypeVar, cast

from ikservo.arguments import parse_number
from ikservo.control.stop_requests import StopRequest, stop_on_signals
from ikservo.errors import IkservoError, NotSettledError, RefusedError, StoppedError
from ikservo.guard import StopKind, StopReason

CANCELLED = StopReason(StopKind.CANCELLED, "Cancelled by the program; torque stays on.")
# Braking takes 0.3 s; a busy machine is given more.
_BRAKE_TIMEOUT_S = 5.0
_SIGNALS_S = 0.05  # time between two checks for signals

P = ParamSpec("P")
T = TypeVar("T")


class Stoppable(Protocol):
    """Methods of an arm that a background motion needs; ``MotionRunner`` provides them."""

    def request_stop(self, reason: StopReason) -> None:
        """Brake the running motion and hold."""

    def acknowledge(self) -> None:
        """Acknowledge a stop."""

    @property
    def stop_reason(self) -> StopReason | None:
        """The reason for the stop; None if the arm is not stopped."""
        ...

    @property
    def stop_requests(self) -> int:
        """Number of stop requests since the last ``acknowledge``."""
        ...


class Turns:
    """A re-entrant lock that is granted in the order of requests.

    A plain lock may wake any waiting thread, so motions could run out of order.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._queue: list[object] = []  # the first holder has the turn
        self._thread: int | None = None  # the thread that holds the lock

    def enqueue(self, holder: object) -> None:
        """Append a holder to the queue; ``hold`` or ``leave`` must follow."""
        with self._changed:
            self._queue.append(holder)

    def leave(self, holder: object) -> None:
        """Leave the queue, and with it the lock."""
        with self._changed:
            if holder in self._queue:  # Ctrl-C may have come before it was added
                self._queue.remove(holder)
            self._changed.notify_all()

    @contextmanager
    def hold(self, holder: object | None = None) -> Generator[None]:
        """Wait for the turn of a queued holder, or of a new one, and hold the lock in the block."""
        thread = threading.get_ident()
        if self._thread == thread:
            yield
            return
        queued, holder = holder is not None, holder or object()
        try:
            if not queued:
                self.enqueue(holder)
            with self._changed:
                self._changed.wait_for(lambda: self._queue[:1] == [holder])
            self._thread = thread
            yield
        finally:
            if self._thread == thread:
                self._thread = None
            self.leave(holder)


class RunningMotion(Generic[T]):
    """A motion that runs in a thread of its own; ``wait`` returns its report.

    ``wait`` raises the motion's error each time it is called. An ``async`` program may
    ``await`` the motion instead; cancelling the task then cancels the motion.

    Args:
        work: Function that plans and executes the motion, and returns its result.
        arm: The arm to move.
        turns: The lock that only one motion holds at a time.
    """

    def __init__(self, work: Callable[[], T], arm: Stoppable, turns: Turns) -> None:
        self._work, self._arm, self._turns = work, arm, turns
        self._process_id = os.getpid()
        self._finished, self._state = threading.Event(), threading.Lock()
        self._cancelled = self._moving = self._raised = False
        self._report: T | None = None
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="ikservo-motion", daemon=True)

    def start(self) -> None:
        """Start the thread; called once."""
        try:
            self._turns.enqueue(self)
            self._thread.start()
        except BaseException:  # Ctrl-C, or the process has too many threads
            if self._thread.ident is None:
                self._finished.set()
                self._turns.leave(self)
            raise

    @property
    def done(self) -> bool:
        """Whether the motion has ended, without waiting."""
        return self._finished.is_set()

    @property
    def cancelled(self) -> bool:
        """Whether ``cancel`` was called before the motion had ended."""
        return self._cancelled

    def wait(self, timeout_s: float | None = None) -> T:
        """Wait for the motion's end and return its result.

        Args:
            timeout_s: Longest wait, by the computer's clock; None waits without limit.

        Raises:
            NotSettledError: The motion has not ended by then, and continues. This error is also a
                ``TimeoutError``.
            StoppedError: The motion was cancelled or stopped; the arm holds.
            KeyboardInterrupt: Ctrl-C; the arm was braked and holds.
            IkservoError: The error that the blocking call would have raised.
        """
        check_not_forked(self._process_id)
        if timeout_s is not None:
            timeout_s = parse_number("The timeout", timeout_s)
        if threading.current_thread() is self._thread:
            raise RefusedError("A motion cannot wait for itself.", "Wait in another thread.")
        end_s = math.inf if timeout_s is None else time.monotonic() + timeout_s
        try:
            # A signal that arrives just before a wait, or in another thread, does not end the wait.
            while not self._finished.wait(min(_SIGNALS_S, max(0.0, end_s - time.monotonic()))):
                if time.monotonic() >= end_s:
                    raise NotSettledError(
                        f"The motion has not ended after {timeout_s:g} s.",
                        "The motion continues: wait again, or cancel it.",
                    )
        except (KeyboardInterrupt, SystemExit):  # the signal's handler has requested the stop
            self._finished.wait(_BRAKE_TIMEOUT_S)
            raise
        self._raised = True
        if self._error is not None:
            raise self._error
        return cast("T", self._report)

    def cancel(self) -> None:
        """Brake within 0.3 s and hold, without waiting; a motion that has not started never starts.

        ``wait`` then raises ``StoppedError``. The next motion needs no ``acknowledge``. A motion
        that has ended is not changed.

        Raises:
            RefusedError: This process is a fork of the one that moves the arm.
        """
        check_not_forked(self._process_id)
        with self._state:
            if self.done:
                return
            self._cancelled = True
            if self._moving:
                self._arm.request_stop(CANCELLED)

    def join(self, timeout_s: float = _BRAKE_TIMEOUT_S) -> bool:
        """Wait without raising the motion's error; return whether the motion has ended."""
        if threading.current_thread() is not self._thread:
            self._finished.wait(timeout_s)
        return self.done

    def __await__(self) -> Generator[object, None, T]:
        """Wait for the motion in an ``async`` program; see ``wait``."""
        return self._result_or_raise().__await__()

    def __repr__(self) -> str:
        """Show whether the motion has ended, and its result."""
        if not self.done:
            return "RunningMotion(running)"
        failed = self._error is not None
        return f"RunningMotion(done, {f'error {self._error!r}' if failed else repr(self._report)})"

    def __del__(self) -> None:
        """Log an error that ``wait`` has not raised; signals were already raised."""
        unraised = isinstance(self._error, Exception) and not self._raised
        if unraised and not self._cancelled:
            logging.getLogger("ikservo").error("A motion nobody waited for failed: %s", self._error)

    async def _result_or_raise(self) -> T:
        import asyncio  # noqa: PLC0415  # 2.5 MB that only programs of asyncio need

        loop = asyncio.get_running_loop()
        try:
            return await loop.run_in_executor(None, self.wait)
        except asyncio.CancelledError:
            self._raised = True
            self.cancel()
            raise

    def _run(self) -> None:
        if self.done:  # Ctrl-C came as it was started
            return
        try:
            with self._turns.hold(self):
                with self._state:
                    if self._cancelled:
                        raise StoppedError(CANCELLED.text)
                    self._moving = True
                try:
                    self._report = self._work()
                finally:
                    self._mark_ended()
        except BaseException as error:  # raised by ``wait``
            self._error = error
            stopped = self._arm.stop_reason is not None
            if self._cancelled and not stopped and isinstance(error, IkservoError):
                # Whatever a cancelled motion raised, it was stopped.
                is_stop = isinstance(error, StoppedError)
                self._error = error if is_stop else StoppedError(CANCELLED.text)
        finally:
            with self._state:
                self._finished.set()

    def _mark_ended(self) -> None:
        """Acknowledge the stop that ``cancel`` requested, unless there was another request."""
        with self._state:
            self._moving = False
            if self._cancelled:
                reason = self._arm.stop_reason
                ours = reason is None or reason.kind is StopKind.CANCELLED
                if ours and self._arm.stop_requests <= 1:
                    self._arm.acknowledge()


Motion = RunningMotion
"""The name of ``RunningMotion`` in version 0.1."""

_running_motions: weakref.WeakSet[RunningMotion[object]] = weakref.WeakSet()


class Background:
    """The motions of one arm, executed one after the other.

    Args:
        arm: The arm.
        stop_request: Ends the running motion when a signal arrives; records which motions were
            requested before a stop.
    """

    def __init__(self, arm: Stoppable, stop_request: StopRequest) -> None:
        self._arm, self._stop_request = arm, stop_request
        self._turns = Turns()
        # Only its thread and its handle keep a motion alive: an error that nobody waits for is
        # logged when the handle is dropped, not when the arm is.
        self._motions: weakref.WeakSet[RunningMotion[object]] = weakref.WeakSet()
        self._stream: RunningMotion[object] | None = None
        self._process_id = os.getpid()

    @contextmanager
    def turn(self) -> Generator[None]:
        """Wait for the motions started so far; the ``with`` block then counts as one requested now.

        Raises:
            RefusedError: A stream of setpoints is open, or this process is a fork of the one that
                opened the arm.
        """
        self._check_no_stream()
        count = self._stop_request.count_at_request
        with self._turns.hold(), self._stop_request.requested(count):
            yield

    def start(self, work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> RunningMotion[T]:
        """Start a motion in a thread, after those requested so far; it counts as requested now.

        Raises:
            RefusedError: See ``turn``.
        """
        self._check_no_stream()
        return self._start_thread(partial(work, *args, **kwargs), self._stop_request.count)

    @property
    def stop_count(self) -> int:
        """The number of stops when the present action of this thread was requested."""
        return self._stop_request.count_at_request

    def requested(self, stop_count: int | None = None) -> AbstractContextManager[None]:
        """Treat this thread's motions in the ``with`` block as one request, which a stop ends.

        Only stops after the first ``stop_count`` stops end it; None means only stops from now on.
        """
        return self._stop_request.requested(stop_count)

    def start_stream(self, work: Callable[[], T]) -> RunningMotion[T]:
        """Start a stream of setpoints; other motions are refused until it has ended.

        Raises:
            RefusedError: Another stream is open.
        """
        self._check_no_stream()
        motion = self._start_thread(work, self._stop_request.count_at_request)
        self._stream = motion  # pyright: ignore[reportAttributeAccessIssue]  # any result
        return motion

    def close(self) -> None:
        """Cancel running and waiting motions, and return once they have ended."""
        if os.getpid() != self._process_id:  # the threads run in the parent only
            return
        motions = list(self._motions)
        for motion in motions:
            motion.cancel()
        for motion in motions:
            motion.join()

    def _start_thread(self, work: Callable[[], T], count: int) -> RunningMotion[T]:
        def requested_work() -> T:
            with self._stop_request.requested(count):
                return work()

        motion = RunningMotion(requested_work, self._arm, self._turns)
        self._motions.add(motion)  # pyright: ignore[reportArgumentType]  # any result
        _running_motions.add(motion)  # pyright: ignore[reportArgumentType]
        stop_on_signals(self._stop_request, lambda: not motion.done)
        motion.start()
        return motion

    def _check_no_stream(self) -> None:
        check_not_forked(self._process_id)
        if self._stream is not None and not self._stream.done:
            raise RefusedError(
                "A stream of setpoints is open.",
                "Leave its `with` block first, or send setpoints through it.",
            )


def check_not_forked(process_id: int) -> None:
    """Raise an error in a forked process, where locks that the parent's threads held stay locked.

    Raises:
        RefusedError: This process is a fork of the process with this id.
    """
    if os.getpid() != process_id:
        raise RefusedError(
            f"The arm was opened by process {process_id}; a forked process cannot use it.",
            "Open the arm in the process that moves it, or start processes with "
            'multiprocessing.get_context("spawn").',
        )


def _cancel_all() -> None:
    """Brake running motions when the program ends, before their threads end."""
    motions = list(_running_motions)
    for motion in motions:
        motion.cancel()
    for motion in motions:
        motion.join(1.0)


atexit.register(_cancel_all)
if hasattr(os, "register_at_fork"):  # not on Windows, which has no fork
    os.register_at_fork(after_in_child=_running_motions.clear)
