"""Single keys from a terminal, without waiting for them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager

__all__ = ["keys"]


@contextmanager
def keys() -> Generator[Callable[[], str]]:
    """Yield what returns the key that was pressed, or nothing; the terminal is put right again."""
    if sys.platform == "win32":
        yield _windows_key
        return
    import termios  # noqa: PLC0415  # there is none on Windows
    import tty  # noqa: PLC0415

    before = termios.tcgetattr(sys.stdin)
    try:
        tty.setcbreak(sys.stdin)  # Ctrl-C still interrupts
        yield _posix_key
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)


def _posix_key() -> str:
    import select  # noqa: PLC0415

    return sys.stdin.read(1) if select.select([sys.stdin], [], [], 0)[0] else ""


def _windows_key() -> str:
    import msvcrt  # noqa: PLC0415  # there is none elsewhere

    if not msvcrt.kbhit():  # pyright: ignore[reportUnknownMemberType, reportAttributeAccessIssue]
        return ""
    key: str = msvcrt.getwch()  # pyright: ignore[reportUnknownMemberType, reportAttributeAccessIssue, reportUnknownVariableType]
    return key  # pyright: ignore[reportUnknownVariableType]
