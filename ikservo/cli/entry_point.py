"""The console entry point: run a command, print errors and hints, return the exit code."""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import shlex
import signal
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import NoReturn

from ikservo.cli.terminal import print_status
from ikservo.errors import ExitCode, IkservoError

__all__ = ["COMMAND", "console", "main", "with_connection_options"]


COMMAND = re.compile(r"\bikservo ([a-z]+)((?: (?!ikservo\b)[^\s,;()`]*[^\s,;()`.:?])*)")
"""A command in a sentence: its name, and its arguments up to punctuation."""

_ARM_AS_OPTION = frozenset(
    [
        "bench",
        "doctor",
        "export",
        "follow",
        "gripper",
        "import",
        "jog",
        "joints",
        "move",
        "pose",
        "record",
        "recover",
        "relax",
        "replay",
        "scan",
        "solve",
        "stop",
        "teach",
        "view",
        "where",
        "workspace",
    ]
)
_ARM_AS_WORD = {"calibrate": 0, "setup": 0, "calibration": 1}
"""At which place among the words of a command its arm stands."""
_NO_PORT = frozenset(("arms", "ports", "sim", "solve", "workspace"))


def with_connection_options(hint: str, words: Sequence[str]) -> str:
    """Return a hint whose commands have the arm and port that a person gave.

    Args:
        hint: A sentence with commands in it.
        words: What the person typed behind ``ikservo``.
    """
    arm, port = _arm_from_arguments(words), _option_value("--port", words)
    return COMMAND.sub(lambda found: _with_arm_and_port(found[1], found[2], arm, port), hint)


def _with_arm_and_port(name: str, arguments: str, arm: str, port: str) -> str:
    """Return a command with an arm and a port where it takes them and has none."""
    if "--help" in arguments:
        return f"ikservo {name}{arguments}"
    if arm and name in _ARM_AS_WORD:
        arguments = _with_arm_argument(arguments, _ARM_AS_WORD[name], shlex.quote(arm))
    elif arm and name in _ARM_AS_OPTION and "--arm" not in arguments:
        arguments += f" --arm {shlex.quote(arm)}"
    takes_port = name in _ARM_AS_WORD or (name in _ARM_AS_OPTION and name not in _NO_PORT)
    if port and takes_port and "--port" not in arguments:
        arguments += f" --port {shlex.quote(port)}"
    return f"ikservo {name}{arguments}"


def _with_arm_argument(arguments: str, place: int, arm: str) -> str:
    """Return arguments with the arm at its place, instead of ``ARM`` or where none stands."""
    if re.search(r"\bARM\b", arguments):
        return re.sub(r"\bARM\b", lambda _: arm, arguments)
    words = arguments.split()
    leading = next((i for i, word in enumerate(words) if word.startswith("-")), len(words))
    if leading <= place:
        words.insert(leading, arm)
    return " ".join(["", *words])


def _arm_from_arguments(words: Sequence[str]) -> str:
    """Return the arm of a command, given as an option or as a word of its own; nothing without."""
    named = _option_value("--arm", words)
    if named or not words or words[0] not in _ARM_AS_WORD:
        return named
    place = _ARM_AS_WORD[words[0]] + 1
    leading = [word for word in words[: place + 1] if not word.startswith("-")]
    return leading[place] if len(leading) > place else ""


def _option_value(name: str, words: Sequence[str]) -> str:
    """Return the value of an option, given as ``--arm x`` or ``--arm=x``; nothing without it."""
    for word, after in zip_longest(words, words[1:], fillvalue=""):
        if word == name:
            return after
        if word.startswith(f"{name}="):
            return word.partition("=")[2]
    return ""


# A coordinate may be negative; an option is not a number. The typographic minus keeps the option
# parser from taking the one for the other, and the quantity parsers read both.
_COMPLETES = "_IKSERVO_COMPLETE"  # set by the shell that asks what may stand at the Tab key
_NEGATIVE = re.compile(r"^-(?=\.?\d|inf|nan)", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class _Ended:
    """How a command ended.

    Attributes:
        code: Its exit code.
        interrupted: Whether Ctrl-C stopped it.
    """

    code: int
    interrupted: bool = False


def console() -> NoReturn:
    """Run the shell's words as a process of its own, and leave at once.

    Everything that has to be closed is closed by now. A command that Ctrl-C has stopped ends by
    SIGINT.
    """
    ended = _ended(sys.argv[1:])
    with contextlib.suppress(OSError, ValueError):
        sys.stdout.flush()
        sys.stderr.flush()
    if ended.interrupted and sys.platform != "win32":
        _end_by_sigint()
    os._exit(ended.code)


def main(words: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        words: What follows ``ikservo`` on the command line; the shell's if None.

    Returns:
        The exit code, see ``ExitCode``.
    """
    return _ended(sys.argv[1:] if words is None else words).code


def _ended(words: Sequence[str]) -> _Ended:
    """Run one command; what ended it becomes words on stderr."""
    words = list(words)
    _prepare_streams()
    try:
        code = _run_command([_NEGATIVE.sub("\N{MINUS SIGN}", word) for word in words])
        sys.stdout.flush()  # here, where a full disk can still be told of
        return _Ended(code)
    except (IkservoError, KeyboardInterrupt, SystemExit, OSError) as error:
        code = _explained(error, words)
        return _Ended(code, code == ExitCode.STOPPED and _is_interrupt(error))


def _explained(error: BaseException, words: Sequence[str]) -> int:
    """Say what ended a command, and return the exit code for it."""
    as_json = "--json" in words
    if isinstance(error, IkservoError):
        hint = with_connection_options(error.command_hint, words)
        return _report_error(error.command_message, hint, error.exit_code, as_json=as_json)
    if not isinstance(error, OSError):  # Ctrl-C; after a motion it says that the arm holds
        message = str(error) if isinstance(error, KeyboardInterrupt) else ""
        return _report_error(message or "Stopped.", "", ExitCode.STOPPED, as_json=as_json)
    _abandon_stdout()  # a full disk behind stdout, a reader that has gone
    ended = _exit_code_of(error)
    if ended is not None:
        return ended
    return _report_error(f"The output could not be written: {error}.", "", ExitCode.FAILED)


def _is_interrupt(error: BaseException) -> bool:
    """Return whether Ctrl-C is behind an error, and not the end of the input at a question."""
    chain = list(_behind(error))
    asked = any(isinstance(each, EOFError) for each in chain)
    return not asked and any(isinstance(each, KeyboardInterrupt) for each in chain)


def _end_by_sigint() -> None:
    """End this process by SIGINT, as if nothing had caught it.

    A shell ends the loop or the script around a command that SIGINT has ended; one that has
    *exited* with 130 counts as one that dealt with Ctrl-C itself, and the loop goes on to the next
    motion. ``$?`` is 130 both ways.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.raise_signal(signal.SIGINT)


def _prepare_streams() -> None:
    """Let output that cannot be shown be shown as it can, and closed streams be empty ones."""
    if sys.stdin is None:  # closed by the shell: <&-
        sys.stdin = open(os.devnull, encoding="utf-8")  # noqa: PTH123, SIM115
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # closed by the shell: >&-
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: PTH123, SIM115
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _run_command(words: list[str]) -> int:
    import typer  # noqa: PLC0415

    from ikservo.cli.app import app  # noqa: PLC0415

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
    if code == ExitCode.STOPPED:  # what newer versions of typer make of Ctrl-C, without a word
        raise KeyboardInterrupt
    return int(code or 0)


def _report_usage(error: Exception, message: str, *, as_json: bool) -> int:
    context = getattr(error, "ctx", None)
    path = getattr(context, "command_path", "ikservo")
    message = message.replace("\N{MINUS SIGN}", "-").strip()
    if not message:  # no words at all: the help has been printed
        return ExitCode.USAGE
    return _report_error(message, f"Try: {path} --help", ExitCode.USAGE, as_json=as_json)


def _abandon_stdout() -> None:
    """Keep Python from writing what is left to a stdout that takes no more."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _exit_code_of(error: BaseException) -> ExitCode | None:
    """Return why the command ended that had no terminal left to say so; None for no such reason."""
    for reason in _behind(error.__context__):
        if isinstance(reason, IkservoError):
            return reason.exit_code
        if isinstance(reason, KeyboardInterrupt):
            return ExitCode.STOPPED
    return None


def _behind(error: BaseException | None) -> Iterator[BaseException]:
    """Yield an error and those in whose handling it was raised, one after the other."""
    while error is not None:
        yield error
        error = error.__context__


def _report_error(message: str, hint: str, code: ExitCode, *, as_json: bool = False) -> int:
    if as_json:
        answer = {"schema": "ikservo/error/1", "error": message, "hint": hint, "exit_code": code}
        print(json.dumps(answer, ensure_ascii=False))  # noqa: T201
    with contextlib.suppress(OSError):  # the terminal was closed: the code is all that is left
        print_status(message)
        if hint:
            print_status(hint)
    return code
