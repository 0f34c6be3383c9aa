"""Signals during a motion: the arm is braked and held before the program ends."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager
from types import FrameType

from ikservo.arm.streaming.halt import CTRL_C, StopKind, StopReason, StopRequest

__all__ = ["ending", "interruptible", "stop_on_signals"]

_REASONS = {
    "SIGINT": CTRL_C,
    "SIGTERM": StopReason(StopKind.TERMINATED, "Stopped by SIGTERM; torque stays on."),
    "SIGHUP": StopReason(
        StopKind.HANGUP, "Stopped because the terminal was closed; torque stays on."
    ),
}
_DEFAULTS = (signal.SIG_DFL, signal.default_int_handler)


def ending(number: int, words: str) -> BaseException:
    """Return what ends the program after a signal has stopped the arm; see decision 19.

    No ``except Exception`` or ``except IkservoError`` catches it, so that a program whose user
    pressed Ctrl-C does not go on to its next motion.

    Args:
        number: The signal; 0 where the program raised ``KeyboardInterrupt`` itself.
        words: What was done about the arm.
    """
    if number in (0, signal.SIGINT):
        return KeyboardInterrupt(words)
    return SystemExit(128 + number)  # what a shell says of a process that a signal ended


_watched: list[tuple[StopRequest, Callable[[], bool]]] = []


def stop_on_signals(stop_request: StopRequest, running: Callable[[], bool]) -> None:
    """Let Ctrl-C, SIGTERM and SIGHUP stop a motion of another thread, wherever this thread is.

    The program is ended besides, see ``ending``. Once nothing runs any more, signals do again what
    they did. Handlers that a program has set itself stay; only the main thread can set any.

    Args:
        stop_request: Set by the signal.
        running: Whether the motion still runs.
    """
    _watched[:] = [each for each in _watched if each[1]()]
    _watched.append((stop_request, running))
    if threading.current_thread() is threading.main_thread():
        for number in _numbers():
            if signal.getsignal(number) in _DEFAULTS:
                signal.signal(number, _stop_watched)


def _stop_watched(number: int, _: FrameType | None) -> None:
    if _request_watched(number):
        raise ending(number, _reason_of(number).text)
    signal.signal(number, _DEFAULTS[number == signal.SIGINT])
    signal.raise_signal(number)


def _request_watched(number: int) -> bool:
    """Stop every motion of the background that still runs; return whether there was one."""
    requests = [request for request, running in _watched if running()]
    for request in requests:
        request.set(_reason_of(number), number)
    return bool(requests)


def _reason_of(number: int) -> StopReason:
    return _REASONS[signal.Signals(number).name]


def _numbers() -> list[int]:
    return [getattr(signal, name) for name in _REASONS if hasattr(signal, name)]


@contextmanager
def interruptible(stop_request: StopRequest, loop_running: Callable[[], bool]) -> Generator[None]:
    """Turn Ctrl-C, SIGTERM and SIGHUP into a stop request, while the block runs.

    Where no control loop runs, the arm holds: ``KeyboardInterrupt`` ends the waiting at once.
    Handlers that a program has set itself stay, and threads other than the main one, to which
    Python gives no signals, are left alone.

    Args:
        stop_request: Set by the signal.
        loop_running: Whether a control loop will see the request in its next cycle.
    """

    def request_stop(number: int, _: FrameType | None) -> None:
        stop_request.set(_reason_of(number), number)
        _request_watched(number)
        if not loop_running():
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    ours = (*_DEFAULTS, _stop_watched)
    before = {n: signal.getsignal(n) for n in _numbers() if signal.getsignal(n) in ours}
    try:
        for number in before:
            signal.signal(number, request_stop)
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
