"""From the shell's words to an exit code: the one place where errors become text."""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import sys
from collections.abc import Sequence
from typing import NoReturn

from ikservo.cli.hints import addressed
from ikservo.cli.output import note
from ikservo.errors import ExitCode, IkservoError

__all__ = ["console", "main"]

# A coordinate may be negative; an option is not a number. The typographic minus keeps the option
# parser from taking the one for the other, and the quantity parsers read both.
_COMPLETES = "_IKSERVO_COMPLETE"  # set by the shell that asks what may stand at the Tab key
_NEGATIVE = re.compile(r"^-(?=\.?\d|inf|nan)", re.IGNORECASE)


def console() -> NoReturn:
    """Run the shell's words as a process of its own, and leave at once.

    Everything that has to be closed is closed when ``main`` returns; unloading the compiled solver
    would take a fifth of a second more.
    """
    code = main()
    with contextlib.suppress(OSError, ValueError):
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(code)


def main(words: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        words: What follows ``ikservo`` on the command line; the shell's if None.

    Returns:
        The exit code, see ``ExitCode``.
    """
    words = list(sys.argv[1:] if words is None else words)
    _ready_streams()
    try:
        code = _run([_NEGATIVE.sub("\N{MINUS SIGN}", word) for word in words])
        sys.stdout.flush()  # here, where a full disk can still be told of
        return code
    except IkservoError as error:
        hint = addressed(error.command_hint, words)
        return _report(error.command_message, hint, error.exit_code, as_json="--json" in words)
    except (KeyboardInterrupt, SystemExit) as error:  # after a motion it says that the arm holds
        message = str(error) if isinstance(error, KeyboardInterrupt) else ""
        return _report(message or "Stopped.", "", ExitCode.STOPPED, as_json="--json" in words)
    except OSError as error:  # a full disk behind stdout, a reader that has gone
        _abandon_stdout()
        ended = _ended_by(error)
        if ended is not None:
            return ended
        return _report(f"The output could not be written: {error}.", "", ExitCode.FAILED)


def _ready_streams() -> None:
    """Let output that cannot be shown be shown as it can, and closed streams be empty ones."""
    if sys.stdin is None:  # closed by the shell: <&-
        sys.stdin = open(os.devnull, encoding="utf-8")  # noqa: PTH123, SIM115
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # closed by the shell: >&-
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: PTH123, SIM115
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _run(words: list[str]) -> int:
    import typer  # noqa: PLC0415

    from ikservo.cli.words import app  # noqa: PLC0415

    try:
        code = typer.main.get_command(app).main(words, prog_name="ikservo", standalone_mode=False)
    except SystemExit as error:
        if _COMPLETES not in os.environ:
            raise
        return int(error.code or 0)
    except typer.Abort:
        raise KeyboardInterrupt from None
    except Exception as error:
        # typer carries click inside and does not name its errors: they are what can format itself.
        explain = getattr(error, "format_message", None)
        if explain is None:
            raise
        return _report_usage(error, str(explain()), as_json="--json" in words)
    return int(code or 0)


def _report_usage(error: Exception, message: str, *, as_json: bool) -> int:
    context = getattr(error, "ctx", None)
    path = getattr(context, "command_path", "ikservo")
    message = message.replace("\N{MINUS SIGN}", "-").strip()
    if not message:  # no words at all: the help has been printed
        return ExitCode.USAGE
    return _report(message, f"Try: {path} --help", ExitCode.USAGE, as_json=as_json)


def _abandon_stdout() -> None:
    """Keep Python from writing what is left to a stdout that takes no more."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _ended_by(error: BaseException) -> ExitCode | None:
    """Return why the command ended that had no terminal left to say so; None for no such reason."""
    reason = error.__context__
    while reason is not None:
        if isinstance(reason, IkservoError):
            return reason.exit_code
        if isinstance(reason, KeyboardInterrupt):
            return ExitCode.STOPPED
        reason = reason.__context__
    return None


def _report(message: str, hint: str, code: ExitCode, *, as_json: bool = False) -> int:
    if as_json:
        answer = {"schema": "ikservo/error/1", "error": message, "hint": hint, "exit_code": code}
        print(json.dumps(answer, ensure_ascii=False))  # noqa: T201
    with contextlib.suppress(OSError):  # the terminal was closed: the code is all that is left
        note(message)
        if hint:
            note(hint)
    return code
