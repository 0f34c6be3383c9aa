"""The command group: commands are listed at once and imported only when they run."""

from __future__ import annotations

import difflib
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import typer
from typer.core import TyperCommand, TyperGroup

from ikservo.errors import ExitCode

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

__all__ = ["COMMANDS", "FORMER_OPTIONS", "PANELS", "app", "names_arm"]

PANELS = {
    "Without an arm": {
        "arms": "List the arms that ship with ikservo.",
        "solve": "Find joints for a point; nothing moves.",
        "scene": "List the things of a scene file, and what of an arm touches them.",
        "workspace": "Compute what the tip can reach; test a point, draw a picture.",
        "sim": "Serve a simulated arm on a pseudo-terminal.",
    },
    "Set up": {
        "ports": "List the USB adapters: chip, stable name, who uses them.",
        "scan": "Find servos at any id and baud rate.",
        "setup": "Give new servos their ids, one at a time.",
        "servo": "Read and write registers of single servos; back up, restore.",
        "monitor": "Log the health of the servos, and report what wears.",
        "doctor": "Check adapter, bus and servos and report faults.",
        "bench": "Measure how fast servos can be read and written.",
        "test": "Measure accuracy and repeatability after ISO 9283.",
        "calibrate": "Measure this arm's zeros, signs and ranges.",
        "identify": "Measure this arm's masses, friction, stiffness; moves slowly.",
        "camera": "Print the board of a camera, or check whether a camera has moved.",
        "calibration": "Compare a calibration with the servos: diff, push, pull.",
        "import": "Import a calibration from LeRobot or a recording.",
        "export": "Export a calibration to LeRobot, or a recording to CSV.",
    },
    "Move": {
        "where": "Show where the arm is: tip, joints, limits, health.",
        "move": "Move the tip to a point.",
        "look": "Find the point that a pixel of the camera sees; move there.",
        "arc": "Move the tip on an arc or a circle.",
        "draw": "Draw the strokes of an SVG or CSV file.",
        "joints": "Move single joints.",
        "pose": "Move to a named pose.",
        "jog": "Move a joint or the tip while a key is held.",
        "gripper": "Open, close, grasp.",
        "view": "Open the browser panel: drag the arm with the mouse.",
    },
    "Teach and replay": {
        "teach": "Save the pose of an arm moved by hand.",
        "record": "Record a motion to a file; show it live in Foxglove.",
        "replay": "Replay a recorded motion.",
        "program": "Write, check and run a file of steps.",
        "follow": "Follow another arm that is guided by hand.",
    },
    "Other machines": {
        "serve": "Serve an arm to programs on other machines.",
        "ros": "Connect an arm to ROS 2, without ROS on this machine.",
        "fleet": "List the arms of other machines: state, operator, health.",
        "net": "Make certificates for other machines; acknowledge a stop.",
    },
    "Stop and recover": {
        "stop": "Stop the arm now, whatever program moves it.",
        "relax": "Lower the arm to its rest pose and switch torque off.",
        "recover": "Clear overload and other alarms.",
    },
}
"""The commands and their help, grouped as ``--help`` prints them."""

COMMANDS = {name: help_ for panel in PANELS.values() for name, help_ in panel.items()}
_PANEL_OF = {name: panel for panel, commands in PANELS.items() for name in commands}

_MODULES = {"import": "import_"}  # no module can have the name of a Python keyword

FORMER_OPTIONS = {
    "arc": {"--centre": "--center"},
    "bench": {"--cycles": "--count"},
    "calibrate": {
        "--free": "--continuous",
        "--sheet-at": "--sheet-origin",
        "--block": "--block-height",
    },
    "follow": {"--time": "--duration"},
    "jog": {"--time": "--duration"},
    "record": {"--time": "--duration"},
    "view": {"--http": "--http-port"},
    "where": {"--interval": "--period", "--times": "--count"},
}
"""Former option names by command; they are still accepted and not listed in the help."""


class LazyCommandGroup(TyperGroup):
    """Imports the module of a command when that command is run."""

    _listing = False

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ANN401  # typer hides click's types
        """List the names in the order of the help."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:  # noqa: ANN401
        """Get the command, or only its name and help while the list is printed."""
        if cmd_name not in COMMANDS:
            return None
        if self._listing:
            return TyperCommand(
                cmd_name, help=COMMANDS[cmd_name], rich_help_panel=_PANEL_OF[cmd_name]
            )
        return _load_command(cmd_name)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:  # noqa: ANN401
        """Find the named command; suggest the closest name if there is none."""
        if args and not args[0].startswith("-") and args[0] not in COMMANDS:
            matches = difflib.get_close_matches(args[0].lower(), COMMANDS, n=1)
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


def names_arm(word: str) -> bool:
    """Check whether a word on the command line can only be an arm: its name, or its file."""
    if word.endswith("arm.toml") or (Path(word) / "arm.toml").is_file():
        return True
    if not word.isidentifier():  # such as a port, a file, a coordinate
        return False
    from ikservo.model import arm_names  # noqa: PLC0415  # loads NumPy

    return word in arm_names()


class _CommandWithArm(TyperCommand):
    """Accepts the arm by ``--arm`` or by its bare name, and only finite numbers of usual size."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401
        """Parse arguments after these forms were replaced by those of the command."""
        rest = self._parse_args(ctx, list(_replace_former_options(self.name or "", args)))
        for parameter in self.params:
            _check_numbers(ctx, parameter, ctx.params.get(parameter.name))
        return rest

    def _parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401
        if any("--arm" in each.opts for each in self.params):
            return super().parse_args(ctx, self._with_arm_as_option(ctx, args))
        argument = next((each for each in self._arguments() if "ARM" in str(each.metavar)), None)
        arm, rest = _split_arm_option(args) if argument is not None else ("", args)
        extra = super().parse_args(ctx, rest)
        if argument is not None and arm:
            source = ctx.get_parameter_source(argument.name)
            if source is not None and source.name == "COMMANDLINE" and argument.nargs == 1:
                ctx.fail(f"The arm is given twice: {ctx.params[argument.name]} and --arm {arm}.")
            named = ctx.params[argument.name] or ()
            ctx.params[argument.name] = arm if argument.nargs == 1 else [arm, *named]
        return extra

    def _arguments(self) -> list[Any]:
        return [each for each in self.params if each.param_type_name == "argument"]

    def _with_arm_as_option(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401
        """Return arguments in which a bare arm at the front of the others stands after --arm."""
        arguments = self._arguments()
        takes_arms = bool(arguments) and "ARM" in str(arguments[0].metavar)
        if takes_arms or _split_arm_option(args)[0] or "--help" in args:
            return args
        values, rest, _ = self.make_parser(ctx).parse_args(args=list(args))
        given: list[Any] = [values.get(each.name) for each in arguments]
        words: list[str] = [each for each in given if isinstance(each, str)]
        for each in (*given, rest):
            words += each if isinstance(each, list | tuple) else ()
        if not words or not names_arm(words[0]):
            return args
        needed = sum(each.required for each in arguments)
        if len(words) <= needed and arguments[0].metavar in _FREE_WORDS:
            return args  # a file or a pose may have the name of an arm
        place = args.index(words[0])
        return [*args[:place], *args[place + 1 :], "--arm", words[0]]


def _check_numbers(ctx: Any, parameter: Any, value: object) -> None:  # noqa: ANN401
    """Refuse numbers whose products overflow, and those that are not finite."""
    if isinstance(value, list | tuple):
        for each in cast("Iterable[object]", value):
            _check_numbers(ctx, parameter, each)
    elif isinstance(value, float | int) and not abs(value) <= _LARGEST_NUMBER:
        raise typer.BadParameter(
            f"{value:g} is not a number between ±{_LARGEST_NUMBER:g}.", ctx=ctx, param=parameter
        )


_LARGEST_NUMBER = 1e9


_FREE_WORDS = ("FILE", "LEADER", "NAME")


def _split_arm_option(args: list[str]) -> tuple[str, list[str]]:
    """Return the value of ``--arm``, empty without it, and the other arguments."""
    for place, arg in enumerate(args):
        if arg.startswith("--arm="):
            return arg.partition("=")[2], [*args[:place], *args[place + 1 :]]
        if arg == "--arm" and place + 1 < len(args):
            return args[place + 1], [*args[:place], *args[place + 2 :]]
    return "", args


def _replace_former_options(command: str, args: list[str]) -> Iterator[str]:
    renamed = FORMER_OPTIONS.get(command, {})
    for arg in args:
        option, equals, value = arg.partition("=")
        yield f"{renamed.get(option, option)}{equals}{value}"


def _load_command(name: str) -> Any:  # noqa: ANN401
    from ikservo.cli.option_groups import with_options_of_groups  # noqa: PLC0415

    module = import_module(f"ikservo.cli.{_MODULES.get(name, name)}")
    command = with_options_of_groups(module.command)
    single = typer.Typer(add_completion=False)
    settings: dict[str, Any] = getattr(module, "CONTEXT_SETTINGS", {})
    single.command(name, cls=_CommandWithArm, context_settings=settings)(command)
    loaded = typer.main.get_command(single)
    loaded.name = name
    return loaded


def _exit_codes() -> str:
    return "Exit codes: " + " · ".join(f"{code.value} {code.meaning}" for code in ExitCode)


app = typer.Typer(
    cls=LazyCommandGroup,
    no_args_is_help=True,
    epilog=_exit_codes(),
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
