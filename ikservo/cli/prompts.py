"""Questions on the terminal, answered only by what is typed after they are printed.

Whatever was typed ahead is discarded before each question: a key that was meant for an earlier
one must not let an arm move or go limp. For the same reason no question has a default answer.
"""

from __future__ import annotations

import contextlib
import os
import sys

import typer

from ikservo.cli.terminal import print_status
from ikservo.cli.text_wrapping import fold_for_stream

__all__ = ["confirm", "read_answer", "wait_for_enter"]

_ANSWERS = {"y": True, "yes": True, "n": False, "no": False}
_MAX_ANSWER_BYTES = 4096


def confirm(question: str) -> bool:
    """Ask a question and return yes or no; anything else typed, Enter too, asks again.

    Raises:
        typer.Abort: The input ended (Ctrl-D, or the terminal was closed).
    """
    while True:
        answer = read_answer(f"{question} [y/n]: ").strip().lower()
        if answer in _ANSWERS:
            return _ANSWERS[answer]
        print_status("Type y or n, then Enter.")


def wait_for_enter(request: str) -> None:
    """Print a request and return once Enter is pressed.

    Raises:
        typer.Abort: The input ended.
    """
    read_answer(f"{request} ")


def read_answer(prompt: str) -> str:
    """Discard what was typed so far, print a prompt on stderr and return the line typed then.

    Raises:
        typer.Abort: The input ended.
    """
    _discard_input()
    print(fold_for_stream(prompt.rstrip(), sys.stderr), end=" ", file=sys.stderr, flush=True)  # noqa: T201
    try:
        line = _read_line()
    except OSError:  # the terminal was closed
        line = ""
    except KeyboardInterrupt:
        print_status("")
        raise
    if not line:
        print_status("")
        raise typer.Abort
    return line.rstrip("\r\n")


def _discard_input() -> None:
    if sys.platform == "win32":
        import msvcrt  # noqa: PLC0415

        while msvcrt.kbhit():  # pyright: ignore[reportUnknownMemberType, reportAttributeAccessIssue]
            msvcrt.getwch()  # pyright: ignore[reportUnknownMemberType, reportAttributeAccessIssue]
        return
    import termios  # noqa: PLC0415  # there is none on Windows

    with contextlib.suppress(termios.error):  # a closed terminal holds no input
        termios.tcflush(sys.stdin, termios.TCIFLUSH)


def _read_line() -> str:
    """Return a line with its end; empty at the end of the input."""
    if sys.platform == "win32":
        return sys.stdin.readline()
    # Read from the descriptor itself: `sys.stdin` would keep a second typed line for later.
    typed = b""
    while not typed.endswith(b"\n"):
        more = os.read(sys.stdin.fileno(), _MAX_ANSWER_BYTES)
        if not more:
            break
        typed += more
    return typed.decode("utf-8", "replace")
