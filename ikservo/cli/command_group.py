"""The command group: the commands of the core and of all apps, imported only when they run."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from ikservo.app import Command
from ikservo.app_discovery import built_in_apps, installed_apps
from ikservo.cli.checked_command import CheckedCommand
from ikservo.cli.terminal import print_status
from ikservo.core_commands import PANELS
from ikservo.errors import ExitCode


@cache
def built_in_commands() -> Mapping[str, Command]:
    """Return the commands of the core and the built-in apps by name, in the order of ``--help``."""
    return _in_order({name: each for app in built_in_apps() for name, each in app.commands.items()})


@cache
def all_commands() -> Mapping[str, Command]:
    """Return the commands of all apps, other distributions included; see ``built_in_commands``.

    Problems with an app from another distribution are reported once on the terminal.
    """
    apps, problems = installed_apps()
    for problem in problems:
        print_status(f"Warning: {problem}")
    others = {name: each for app in apps for name, each in app.commands.items()}
    return _in_order({**built_in_commands(), **others})


def find_command(name: str) -> Command | None:
    """Find a command; other distributions are searched only if no built-in command has the name."""
    return built_in_commands().get(name) or all_commands().get(name)


def _in_order(commands: Mapping[str, Command]) -> Mapping[str, Command]:
    panels = [*PANELS, *sorted({each.panel for each in commands.values()} - {*PANELS})]
    return dict(sorted(commands.items(), key=lambda item: panels.index(item[1].panel)))


class LazyCommandGroup(TyperGroup):
    """Group that imports the module of a command when that command is run.

    Attributes:
        prefix: The beginning of its commands' names, such as "import "; may be empty.
    """

    prefix = ""
    _listing = False

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ANN401  # typer hides click's types
        """List the names in the order of ``--help``."""
        names = [name for name in all_commands() if name.startswith(self.prefix)]
        return [name for name in (each[len(self.prefix) :] for each in names) if " " not in name]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:  # noqa: ANN401
        """Get the command, or only its name and help while the list is printed."""
        full_name = self.prefix + cmd_name
        found = find_command(full_name)
        if found is None:
            return None
        if self._listing:
            panel = None if self.prefix else found.panel
            return TyperCommand(cmd_name, help=found.help, rich_help_panel=panel)
        if not found.module:
            group = LazyCommandGroup(name=cmd_name, help=found.help, no_args_is_help=True)
            group.prefix = f"{full_name} "
            return group
        return load_command(full_name, found)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401
        """Parse arguments; the arm and options may precede the name of a sub-command."""
        names = self.list_commands(ctx) if self.prefix else []
        place = next((i for i, word in enumerate(args) if word in names), 0)
        return super().parse_args(
            ctx, [*args[place : place + 1], *args[:place], *args[place + 1 :]]
        )

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:  # noqa: ANN401
        """Find the command with a name; suggest the closest name if there is none."""
        if len(args) > 1 and " ".join(args[:2]) in built_in_commands():  # such as "arms new"
            args = [" ".join(args[:2]), *args[2:]]
        if args and not args[0].startswith("-") and find_command(self.prefix + args[0]) is None:
            matches = difflib.get_close_matches(args[0].lower(), self.list_commands(ctx), n=1)
            suggestion = f" Did you mean {matches[0]}?" if matches else ""
            ctx.fail(f"No such command {args[0]!r}.{suggestion}")
        return super().resolve_command(ctx, args)

    def format_help(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401
        """Print the help without importing any command."""
        self._listing = True
        try:
            super().format_help(ctx, formatter)
        finally:
            self._listing = False


def load_command(name: str, found: Command) -> Any:  # noqa: ANN401
    """Import the module of a command; return the command in the form that click runs."""
    from ikservo.cli.option_groups import with_options_of_groups  # noqa: PLC0415

    place, _, function = found.module.partition(":")
    module = import_module(place)
    command = with_options_of_groups(getattr(module, function or "command"))
    single = typer.Typer(add_completion=False)
    settings: dict[str, Any] = getattr(module, "CONTEXT_SETTINGS", {})
    single.command(name, cls=CheckedCommand, context_settings=settings)(command)
    loaded = typer.main.get_command(single)
    loaded.name = name
    return loaded


app = typer.Typer(
    cls=LazyCommandGroup,
    no_args_is_help=True,
    epilog="Exit codes: " + " · ".join(f"{code.value} {code.meaning}" for code in ExitCode),
    context_settings={"help_option_names": ["-h", "--help"]},  # for the commands as well
)


def _print_version(requested: bool) -> None:
    if requested:
        from ikservo import __version__  # noqa: PLC0415

        typer.echo(__version__)
        raise typer.Exit


@app.callback()
def _root_command(  # pyright: ignore[reportUnusedFunction]
    version: bool = typer.Option(
        False,
        "--version",
        help="Print the version and exit.",
        callback=_print_version,
        is_eager=True,
    ),
) -> None:
    """Drive robot arms of serial bus servos to points in metres.

    ikservo move 0.25 0.05 0.15 --arm so101 --port sim    no arm needed
    """
