"""``ikservo sim``: a simulated arm on a pseudo-terminal, for any servo program."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import entry_points
from typing import Annotated, Any, cast

import typer

from ikservo.errors import IkservoError
from ikservo.model import find_arm

__all__ = ["CONTEXT_SETTINGS", "command"]

_GROUP = "ikservo.servers"

# All arguments but the arm's name are passed to the simulator, which has its own help.
CONTEXT_SETTINGS: dict[str, Any] = {"ignore_unknown_options": True, "help_option_names": []}

SimArguments = Annotated[list[str] | None, typer.Argument(metavar="[ARM] [OPTIONS]…")]


def command(arguments: SimArguments = None) -> None:
    """Serve a simulated arm on a pseudo-terminal; prints the port and runs until stopped.

    ikservo sim so101
    """
    args = [arg.replace("\N{MINUS SIGN}", "-") for arg in arguments or ["--help"]]
    if not args[0].startswith("-"):
        args = [str(find_arm(args[0]).resolve()), *args[1:]]
    raise typer.Exit(_load_server()(args))


def _load_server() -> Callable[[list[str]], int]:
    for entry_point in entry_points(group=_GROUP, name="sim"):
        return cast("Callable[[list[str]], int]", entry_point.load())
    raise IkservoError("The simulator is not installed.", "Install it: pip install ikservo")
