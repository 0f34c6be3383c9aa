"""``ikservo sim``: a simulated arm on a pseudo-terminal, for any servo program."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import entry_points
from importlib.util import find_spec
from typing import Annotated, Any, cast

import typer

from ikservo.calibration.paths import identified_of
from ikservo.cli.terminal import print_status
from ikservo.errors import IkservoError, InputError
from ikservo.model import load_model
from ikservo.remedies import install_command

_GROUP = "ikservo.servers"
_AS_IDENTIFIED = "--as-identified"

# All arguments except the arm's name are passed to the simulator, which has its own help.
CONTEXT_SETTINGS: dict[str, Any] = {"ignore_unknown_options": True, "help_option_names": []}

SimArguments = Annotated[list[str] | None, typer.Argument(metavar="[ARM] [OPTIONS]…")]


def command(arguments: SimArguments = None) -> None:
    """Serve a simulated arm on a pseudo-terminal: print the port, and run until stopped.

    ikservo sim so101

    ikservo sim so101 --as-identified      with masses and motors found by `ikservo identify`
    """
    args = [arg.replace("\N{MINUS SIGN}", "-") for arg in arguments or ["--help"]]
    if not args[0].startswith("-"):
        model = load_model(args[0])
        args = [str(model.path.resolve()), *_with_identified(model.name, args[1:])]
    serve = _load_server()
    try:
        code = serve(args)
    except SystemExit as end:  # the simulator has printed its help
        code = end.code if isinstance(end.code, int) else 0
    raise typer.Exit(code)


def _with_identified(name: str, args: list[str]) -> list[str]:
    """Return arguments in which the file of the identified arm replaces ``--as-identified``.

    Raises:
        InputError: The arm has not been identified yet.
        FileFormatError: The file of the identified arm is damaged.
    """
    if _AS_IDENTIFIED not in args:
        return args
    from ikservo.calibration.identified_file import read_identified  # noqa: PLC0415  # seldom

    files = sorted(identified_of(name), key=lambda path: path.stat().st_mtime)
    if not files:
        raise InputError(
            f"{name} has not been identified yet.", f"Run this first: ikservo identify --arm {name}"
        )
    read_identified(files[-1])
    if len(files) > 1:
        print_status(
            f"{name} was identified on {len(files)} adapters; using the newest: {files[-1]}"
        )
    return [*(arg for arg in args if arg != _AS_IDENTIFIED), "--parameters", str(files[-1])]


def _load_server() -> Callable[[list[str]], int]:
    if find_spec("termios") is None:  # Windows
        hint = "Other commands can simulate an arm themselves: add --port sim"
        raise IkservoError("This system has no pseudo-terminals, which `ikservo sim` needs.", hint)
    for entry_point in entry_points(group=_GROUP, name="sim"):
        return cast("Callable[[list[str]], int]", entry_point.load())
    raise IkservoError("The simulator is not installed.", f"Install it: {install_command()}")
