"""The console entry point: run a command, print errors and hints, return the exit code."""

from __future__ import annotations

import contextlib
import io
import os
import re
import shlex
import signal
import sys
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import NoReturn

from ikservo.cli.terminal import print_json, print_status
from ikservo.errors import ExitCode, IkservoError

COMMAND = re.compile(r"\bikservo ([a-z]+)((?: (?!ikservo\b)[^\s,;()`]*[^\s,;()`.:?])*)")
"""Pattern of a command in a sentence: its name, and its arguments up to punctuation."""

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
_ARM_AS_ARGUMENT = {"calibrate": 0, "setup": 0, "calibration": 1}
"""Index of the arm among the positional arguments of a command."""
_BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "GOTO_NUM_THREADS", "OMP_NUM_THREADS")
"""Environment variables that OpenBLAS reads, in this order."""
_NO_PORT = frozenset(("arms", "ports", "sim", "solve", "workspace"))


def with_connection_options(hint: str, args: Sequence[str]) -> str:
    """Return a hint with the user's arm and port, from ``args``, in its commands."""
    arm, port = _arm_from_arguments(args), _option_value("--port", args)
    return COMMAND.sub(lambda found: _with_arm_and_port(found[1], found[2], arm, port), hint)


def _with_arm_and_port(name: str, arguments: str, arm: str, port: str) -> str:
    """Add arm and port to a command that accepts them and does not name them yet."""
    if "--help" in arguments:
        return f"ikservo {name}{arguments}"
    if arm and name in _ARM_AS_ARGUMENT:
        arguments = _with_arm_argument(arguments, _ARM_AS_ARGUMENT[name], shlex.quote(arm))
    elif arm and name in _ARM_AS_OPTION and "--arm" not in arguments:
        arguments += f" --arm {shlex.quote(arm)}"
    takes_port = name in _ARM_AS_ARGUMENT or (name in _ARM_AS_OPTION and name not in _NO_PORT)
    if port and takes_port and "--port" not in arguments:
        arguments += f" --port {shlex.quote(port)}"
    return f"ikservo {name}{arguments}"


def _with_arm_argument(arguments: str, place: int, arm: str) -> str:
    """Return arguments with the arm inserted, replacing a placeholder ``ARM`` if there is one."""
    if re.search(r"\bARM\b", arguments):
        return re.sub(r"\bARM\b", lambda _: arm, arguments)
    args = arguments.split()
    positional = next((i for i, arg in enumerate(args) if arg.startswith("-")), len(args))
    if positional <= place:
        args.insert(positional, arm)
    return " ".join(["", *args])


def _arm_from_arguments(args: Sequence[str]) -> str:
    """Return the arm of a command, given as option or positional argument; empty if missing."""
    from_option = _option_value("--arm", args)
    if from_option or not args:
        return from_option
    if args[0] not in _ARM_AS_ARGUMENT:
        first = next((word for word in args[1:2] if not word.startswith("-")), "")
        if not first:
            return ""
        from ikservo.cli.checked_command import names_arm  # noqa: PLC0415  # loads typer

        return first if names_arm(first) else ""
    place = _ARM_AS_ARGUMENT[args[0]] + 1
    positional = [arg for arg in args[: place + 1] if not arg.startswith("-")]
    return positional[place] if len(positional) > place else ""


def _option_value(name: str, args: Sequence[str]) -> str:
    """Return the value of an option, given as ``--arm x`` or ``--arm=x``; empty if missing."""
    for arg, value in zip_longest(args, args[1:], fillvalue=""):
        if arg == name:
            return value
        if arg.startswith(f"{name}="):
            return arg.partition("=")[2]
    return ""


_COMPLETES = "_IKSERVO_COMPLETE"  # set by a shell that requests completions
# A coordinate may be negative; an option is not a number. The typographic minus prevents the
# option parser from confusing them, and the quantity parsers accept both.
_NEGATIVE = re.compile(r"^-(?=\.?\d|inf|nan)", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class _Outcome:
    """Exit code of a command, and whether Ctrl-C stopped it."""

    code: int
    interrupted: bool = False


def console() -> NoReturn:
    """Run the command line of this process, and exit at once.

    Before the exit, everything is closed. If Ctrl-C has stopped the command, the process ends by
    SIGINT.
    """
    # NumPy reads this when it loads. The threads of BLAS spin while they wait for each other: on
    # busy cores, decomposing a small matrix took a hundred times the processor time, and slowed
    # the control loop. The user may set another number of threads.
    if not any(name in os.environ for name in _BLAS_THREADS):
        os.environ[_BLAS_THREADS[0]] = "1"
    outcome = _run_and_report(sys.argv[1:])
    with contextlib.suppress(OSError, ValueError):
        sys.stdout.flush()
        sys.stderr.flush()
    if outcome.interrupted and sys.platform != "win32":
        # A shell ends the loop or script around a command that was ended by SIGINT. A command that
        # *exits* with 130 counts as having handled Ctrl-C itself, and the loop continues with the
        # next motion. ``$?`` is 130 in both cases.
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        signal.raise_signal(signal.SIGINT)
    os._exit(outcome.code)


def main(args: Sequence[str] | None = None) -> int:
    """Run one command, by default of this process; return its ``ExitCode``."""
    return _run_and_report(sys.argv[1:] if args is None else args).code


def _run_and_report(args: Sequence[str]) -> _Outcome:
    """Run one command; report errors on stderr."""
    args = list(args)
    if sys.stdin is None:  # closed by the shell: <&-
        sys.stdin = open(os.devnull, encoding="utf-8")  # noqa: PTH123, SIM115
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # closed by the shell: >&-
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: PTH123, SIM115
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # characters that it cannot encode
    with warnings.catch_warnings():
        # As a sentence, without the place in the code that issued it.
        warnings.showwarning = lambda message, category, filename, lineno, file=None, line=None: (
            print_status(str(message))
        )
        try:
            code = _run_command([_NEGATIVE.sub("\N{MINUS SIGN}", arg) for arg in args])
            sys.stdout.flush()  # here, where a full disk can still be reported
            return _Outcome(code)
        except (IkservoError, KeyboardInterrupt, SystemExit, OSError) as raised:
            # typer turns a broken pipe into SystemExit.
            cause = raised.__context__ if isinstance(raised, SystemExit) else None
            error = cause if isinstance(cause, BrokenPipeError) else raised
            code = _report_failure(error, args)
            return _Outcome(code, code == ExitCode.STOPPED and _is_interrupt(error))


def _report_failure(error: BaseException, args: Sequence[str]) -> int:
    """Report an error that ended a command, and return its exit code."""
    as_json = "--json" in args
    if isinstance(error, IkservoError):
        hint = with_connection_options(error.command_hint, args)
        return _report_error(error.command_message, hint, error.exit_code, as_json=as_json)
    if not isinstance(error, OSError):  # Ctrl-C; after a motion the text says that the arm holds
        message = str(error) if isinstance(error, KeyboardInterrupt) else ""
        return _report_error(message or "Stopped.", "", ExitCode.STOPPED, as_json=as_json)
    # Stdout is on a full disk, or its reader has exited: the buffer cannot be written.
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    # The previous error has not been reported yet.
    chain = _error_chain(error.__context__)
    reason = next((e for e in chain if isinstance(e, IkservoError | KeyboardInterrupt)), None)
    if reason is not None:  # such as a full disk
        return _report_failure(reason, args)
    if isinstance(error, BrokenPipeError):  # such as `| head`, which has read enough
        return ExitCode.FAILED
    return _report_error(f"The output could not be written: {error}.", "", ExitCode.FAILED)


def _is_interrupt(error: BaseException) -> bool:
    """Check whether Ctrl-C caused an error, rather than the end of input at a prompt."""
    chain = list(_error_chain(error))
    at_prompt = any(isinstance(each, EOFError) for each in chain)
    return not at_prompt and any(isinstance(each, KeyboardInterrupt) for each in chain)


def _run_command(args: list[str]) -> int:
    if args[:1] == ["stop"] and _COMPLETES not in os.environ:
        from ikservo.cli.quick_stop import quick_stop  # noqa: PLC0415

        code = quick_stop(args[1:])
        if code is not None:
            return code
    import typer  # noqa: PLC0415

    from ikservo.cli.command_group import app  # noqa: PLC0415

    try:
        code = typer.main.get_command(app).main(args, prog_name="ikservo", standalone_mode=False)
    except SystemExit as error:
        if _COMPLETES not in os.environ:
            raise
        return int(error.code or 0)
    except typer.Abort:
        raise KeyboardInterrupt from None
    except Exception as error:
        # typer vendors click without naming its errors, which can be recognised by their format
        # method.
        explain = getattr(error, "format_message", None)
        if explain is None:
            raise
        message = str(explain()).replace("\N{MINUS SIGN}", "-").strip()
        message = message.replace(": Value error, ", ": ")  # typer's prefix of a wrong choice
        if not message:  # no arguments: the help has been printed
            return ExitCode.USAGE
        path = getattr(getattr(error, "ctx", None), "command_path", "ikservo")
        hint = f"Try: {path} --help"
        return _report_error(message, hint, ExitCode.USAGE, as_json="--json" in args)
    if code == ExitCode.STOPPED:  # newer versions of typer return this code for Ctrl-C
        raise KeyboardInterrupt
    return int(code or 0)


def _error_chain(error: BaseException | None) -> Iterator[BaseException]:
    """Yield an error, and the errors that were being handled when it was raised."""
    while error is not None:
        yield error
        error = error.__context__


def _report_error(message: str, hint: str, code: ExitCode, *, as_json: bool = False) -> int:
    if as_json:
        with contextlib.suppress(OSError):  # the reader of stdout has exited
            print_json("error", error=message, hint=hint, exit_code=code)
    with contextlib.suppress(OSError):  # the terminal was closed: only the exit code remains
        print_status(message)
        if hint:
            print_status(hint)
    return code
