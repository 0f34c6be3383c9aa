"""Single keys from a terminal, without waiting for them."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager

__all__ = ["Keys", "keys"]

Keys = Callable[[], str]
"""Returns the keys that were pressed since the last call, in order; empty for none."""

_MOST_BYTES = 1024
# Arrow and function keys arrive as several characters, whose letters must not pass for keys.
_ESCAPE_SEQUENCE = re.compile("\x1b(\\[[0-?]*[ -/]*[@-~]|O.|.)?", re.DOTALL)


@contextmanager
def keys() -> Generator[Keys]:
    """Yield a function that returns the keys pressed since its last call.

    What was typed before is discarded, as is what is left unread at the end; the terminal is then
    set back.
    """
    if sys.platform == "win32":
        _windows_keys()
        yield _windows_keys
        return
    import termios  # noqa: PLC0415  # there is none on Windows
    import tty  # noqa: PLC0415

    before = termios.tcgetattr(sys.stdin)
    try:
        tty.setcbreak(sys.stdin, termios.TCSAFLUSH)  # Ctrl-C still interrupts
        yield _posix_keys
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSAFLUSH, before)


def _posix_keys() -> str:
    import select  # noqa: PLC0415

    # Read from the descriptor itself: `sys.stdin` would read ahead and hide keys from `select`.
    descriptor = sys.stdin.fileno()
    if not select.select([descriptor], [], [], 0)[0]:
        return ""
    typed = os.read(descriptor, _MOST_BYTES).decode("utf-8", "ignore")
    return _ESCAPE_SEQUENCE.sub("", typed)


def _windows_keys() -> str:
    import msvcrt  # noqa: PLC0415  # there is none elsewhere

    typed = ""
    while msvcrt.kbhit():  # pyright: ignore[reportUnknownMemberType, reportAttributeAccessIssue]
        key: str = msvcrt.getwch()  # pyright: ignore[reportUnknownMemberType, reportAttributeAccessIssue, reportUnknownVariableType]
        typed = f"{typed}{key}"
    return typed
