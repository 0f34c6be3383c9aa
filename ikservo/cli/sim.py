"""``ikservo sim``: a simulated arm on a pseudo-terminal, for any program that speaks to servos."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import entry_points
from typing import Annotated, Any, cast

import typer

from ikservo.errors import IkservoError
from ikservo.model import find_arm

__all__ = ["CONTEXT_SETTINGS", "command"]

_GROUP = "ikservo.servers"

# Everything but the arm's name belongs to the simulator, which explains its own options.
CONTEXT_SETTINGS: dict[str, Any] = {"ignore_unknown_options": True, "help_option_names": []}

LazyCommandGroup = Annotated[list[str] | None, typer.Argument(metavar="[ARM] [OPTIONS]…")]


def command(words: LazyCommandGroup = None) -> None:
    """Serve a simulated arm on a pseudo-terminal; prints the port and runs until stopped.

    ikservo sim so101
    """
    words = [word.replace("\N{MINUS SIGN}", "-") for word in words or ["--help"]]
    if not words[0].startswith("-"):
        words = [str(find_arm(words[0]).resolve()), *words[1:]]
    raise typer.Exit(_load_server()(words))


def _load_server() -> Callable[[list[str]], int]:
    for entry_point in entry_points(group=_GROUP, name="sim"):
        return cast("Callable[[list[str]], int]", entry_point.load())
    raise IkservoError("The simulator is not installed.", "Install it: pip install ikservo")
