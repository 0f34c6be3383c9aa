"""The list of commands, loaded one at a time: the list must not cost what the commands cost."""

from __future__ import annotations

import difflib
from importlib import import_module
from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperCommand, TyperGroup

from ikservo.errors import ExitCode

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["WORDS", "app"]

WORDS = {
    "arms": "The arms that ship with ikservo.",
    "ports": "The USB adapters: chip, stable name, who holds them.",
    "scan": "Find servos at any id and baud rate.",
    "setup": "Give new servos their ids, one at a time.",
    "doctor": "What is wrong between this computer and the servos.",
    "calibrate": "This arm's own zeros, signs and ranges, found by hand.",
    "calibration": "Compare a calibration with the servos: diff, push, pull.",
    "import": "Take a calibration over from LeRobot.",
    "export": "Hand a calibration to LeRobot.",
    "where": "Where the arm is: tip, joints, limits, health.",
    "move": "Move the tip to a point.",
    "joints": "Move single joints.",
    "jog": "Move a joint or the tip while a key is held.",
    "gripper": "Open, close, grasp.",
    "pose": "Move to a named pose.",
    "teach": "Give the pose in your hand a name.",
    "record": "Write a motion of your hand to a file.",
    "replay": "Play a recorded motion back.",
    "follow": "Lead this arm by another one in your hand.",
    "stop": "Hold now, whatever program moves the arm.",
    "relax": "Lower the arm to its rest pose and release it.",
    "recover": "Clear overload and other alarms.",
    "view": "A page on which the arm is grabbed and pulled.",
    "solve": "Find joints for a point; nothing moves.",
    "workspace": "What the tip can reach: counts, a test of a point, a picture.",
    "bench": "How fast the servos can be read and told.",
    "sim": "Serve a simulated arm on a pseudo-terminal.",
}

_MODULES = {"import": "import_"}  # no module can have the name of a Python keyword


class Words(TyperGroup):
    """Imports the module of a command when that command is asked for."""

    _listing = False

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ANN401  # typer hides click's types
        """Return the names in the order a newcomer meets them."""
        return list(WORDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:  # noqa: ANN401
        """Return the command, or only its name and help while the list is printed."""
        if cmd_name not in WORDS:
            return None
        if self._listing:
            return TyperCommand(cmd_name, help=WORDS[cmd_name])
        return _load(cmd_name)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:  # noqa: ANN401
        """Return the command that is meant, or offer the closest where there is none."""
        if args and not args[0].startswith("-") and args[0] not in WORDS:
            close = difflib.get_close_matches(args[0].lower(), WORDS, n=1)
            offer = f" Did you mean {close[0]}?" if close else ""
            ctx.fail(f"No such command {args[0]!r}.{offer}")
        return super().resolve_command(ctx, args)

    def format_help(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401
        """Print the help without importing any command."""
        self._listing = True
        try:
            super().format_help(ctx, formatter)
        finally:
            self._listing = False


def _load(name: str) -> Any:  # noqa: ANN401
    module = import_module(f"ikservo.cli.{_MODULES.get(name, name)}")
    command: Callable[..., None] = module.command
    single = typer.Typer(add_completion=False)
    settings: dict[str, Any] = getattr(module, "CONTEXT_SETTINGS", {})
    single.command(name, context_settings=settings)(command)
    loaded = typer.main.get_command(single)
    loaded.name = name
    return loaded


def _exit_codes() -> str:
    return "Exit codes: " + " · ".join(f"{code.value} {code.meaning}" for code in ExitCode)


app = typer.Typer(cls=Words, no_args_is_help=True, epilog=_exit_codes())


@app.callback()
def _root(  # pyright: ignore[reportUnusedFunction]
    version: bool = typer.Option(False, "--version", help="Print the version and exit."),
) -> None:
    """A box of bus servos becomes an arm that goes where you point.

    ikservo move 0.25 0.05 0.15 --arm so101 --port sim    no arm needed
    """
    if version:
        from importlib.metadata import version as installed  # noqa: PLC0415

        typer.echo(installed("ikservo"))
        raise typer.Exit
