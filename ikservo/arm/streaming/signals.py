"""Signals during a motion: the arm is braked and held before the program ends."""

from __future__ import annotations

import signal
import threading
from collections.abc import Generator
from contextlib import contextmanager
from types import FrameType

from ikservo.arm.streaming.halt import CTRL_C, Halt

__all__ = ["CTRL_C", "TERMINATED", "interruptible"]

TERMINATED = "Stopped by a request to end (SIGTERM); the arm holds."

_WORDS = {
    "SIGINT": CTRL_C,
    "SIGTERM": TERMINATED,
    "SIGHUP": "Stopped because the terminal was closed; the arm holds.",
}
_DEFAULTS = (signal.SIG_DFL, signal.default_int_handler)


@contextmanager
def interruptible(halt: Halt) -> Generator[None]:
    """Turn Ctrl-C, SIGTERM and SIGHUP into the wish to stop, while the block runs.

    Where nobody streams, nothing moves by our will: ``KeyboardInterrupt`` ends the waiting at once.
    Handlers that a program has set itself stay, and threads other than the main one, to which
    Python gives no signals, are left alone.

    Args:
        halt: Where the wish is put.
    """

    def ask(number: int, _: FrameType | None) -> None:
        halt.ask(_WORDS[signal.Signals(number).name])
        if not halt.heeded:
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = [getattr(signal, name) for name in _WORDS if hasattr(signal, name)]
    before = {n: signal.getsignal(n) for n in numbers if signal.getsignal(n) in _DEFAULTS}
    try:
        for number in before:
            signal.signal(number, ask)
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
