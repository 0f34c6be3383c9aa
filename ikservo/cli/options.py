"""Options shared by commands, in groups; quantities with units; shell completion."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from ikservo.arm.tool_orientation import ToolOrientation
    from ikservo.model import Model

__all__ = [
    "ArmConnection",
    "ArmOption",
    "CountOption",
    "DurationOption",
    "JsonOption",
    "Length",
    "MotionOptions",
    "NamedArmConnection",
    "NamedServoConnection",
    "OverwriteOption",
    "ServoConnection",
    "SpeedOption",
    "TipOption",
    "ToolOptions",
    "ToolSpeedOption",
    "UncalibratedOption",
    "YesOption",
    "complete_actions",
    "complete_arms",
    "complete_jogs",
    "complete_joints",
    "complete_methods",
    "complete_openings",
    "complete_poses",
    "complete_speeds",
    "parse_angle_rad",
    "parse_axis",
    "parse_force_n",
    "parse_length_m",
    "parse_point_m",
    "parse_time_s",
    "parse_tool_speed_m_s",
]


_NUMBER = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)\s*([a-z°]*)", re.IGNORECASE)
_METRES = {"": 1.0, "m": 1.0, "cm": 0.01, "mm": 0.001}
_TOOL_SPEEDS = {"": 0.001, "mm": 0.001, "cm": 0.01, "m": 1.0}
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_SECONDS = {"": 1.0, "s": 1.0, "ms": 0.001, "min": 60.0}
_NEWTONS = {"": 1.0, "n": 1.0, "mn": 0.001}
_RADIANS = {"": math.pi / 180, "deg": math.pi / 180, "°": math.pi / 180, "rad": 1.0}


def parse_length_m(text: str | float) -> float:
    """Parse metres from ``0.25``, ``0.25m``, ``25cm`` or ``250mm``."""
    return _parse_quantity(str(text), _METRES, "a length like 0.25, 250mm or 25cm")


def parse_angle_rad(text: str) -> float:
    """Parse radians from degrees, ``30`` or ``30deg``, or from ``0.2rad``."""
    return _parse_quantity(text, _RADIANS, "an angle like 30, 30deg or 0.2rad")


def parse_force_n(text: str) -> float:
    """Parse newtons from ``5``, ``5N`` or ``500mN``."""
    return _parse_quantity(text, _NEWTONS, "a force like 5, 5N or 500mN")


def parse_time_s(text: str | float) -> float:
    """Parse seconds above 0 from ``2``, ``2s``, ``500ms`` or ``1min``."""
    time_s = _parse_quantity(str(text), _SECONDS, "a time like 2, 2s, 500ms or 1min")
    if time_s <= 0.0:
        raise typer.BadParameter(f"{text!r} is not a time above 0.")
    return time_s


def parse_tool_speed_m_s(text: str) -> float:
    """Return m/s above 0 from ``50``, ``50mm/s``, ``5cm/s`` or ``0.05m/s``."""
    speed_m_s = _parse_quantity(
        text.strip().removesuffix("/s"), _TOOL_SPEEDS, "a speed like 50, 50mm/s or 0.05m/s"
    )
    if speed_m_s <= 0.0:
        raise typer.BadParameter(f"{text!r} is not a speed above 0.")
    return speed_m_s


def parse_axis(text: str) -> tuple[float, float, float]:
    """Parse a direction from ``x``, ``y`` or ``z``, or from three numbers like ``0,0,-1``."""
    if text.lower() in _AXES:
        return _AXES[text.lower()]
    parts = [
        _NUMBER.fullmatch(part.strip()) for part in text.replace("\N{MINUS SIGN}", "-").split(",")
    ]
    numbers = [float(part[1]) for part in parts if part is not None and not part[2]]
    if len(parts) != 3 or len(numbers) != 3:
        raise typer.BadParameter(f"{text!r} is not a direction like x, or 0,0,-1.")
    return (numbers[0], numbers[1], numbers[2])


def parse_point_m(text: str) -> tuple[float, float, float]:
    """Parse a point from three lengths like ``0.25,-50mm,0.1``, metres."""
    parts = text.split(",")
    if len(parts) != 3:
        raise typer.BadParameter(f"{text!r} is not a point like 0.25,-50mm,0.1.")
    return (parse_length_m(parts[0]), parse_length_m(parts[1]), parse_length_m(parts[2]))


def _parse_quantity(text: str, units: dict[str, float], expected: str) -> float:
    text = text.replace("\N{MINUS SIGN}", "-")
    match = _NUMBER.fullmatch(text.strip())
    if match is None and re.fullmatch(r"[-+]?\d+,\d+\s*[a-z°]*", text.strip(), re.IGNORECASE):
        point = text.replace(",", ".")
        raise typer.BadParameter(f"{text!r} has a comma; use a decimal point: {point}")
    if match is None or match[2].lower() not in units:
        raise typer.BadParameter(f"{text!r} is not {expected}.")
    value = float(match[1]) * units[match[2].lower()]
    if not math.isfinite(value):
        raise typer.BadParameter(f"{text!r} is not finite. Expected {expected}.")
    return value


_SPEEDS = ("slow", "normal", "fast")
_DIRECTIONS = ("x", "y", "z", "up", "down")


def complete_arms(incomplete: str) -> list[str]:
    """Return the arms whose names start with a prefix."""
    from ikservo.model import arm_names  # noqa: PLC0415  # the Tab key should not wait for more

    return [name for name in arm_names() if name.startswith(incomplete)]


def complete_poses(ctx: Any, incomplete: str) -> list[str]:  # noqa: ANN401  # typer hides click's types
    """Return the poses of the chosen arm, taught ones included, that start with a prefix."""
    from ikservo.arm.poses import known_pose_names  # noqa: PLC0415

    model = _model_from_context(ctx)
    return [] if model is None else _filter_by_prefix(known_pose_names(model), incomplete)


def complete_joints(ctx: Any, incomplete: str) -> list[str]:  # noqa: ANN401
    """Return the joints of the chosen arm as ``NAME=``, without those given before."""
    model = _model_from_context(ctx)
    given = {str(goal).partition("=")[0] for goal in ctx.params.get("goals") or ()}
    names = [] if model is None else [joint.name for joint in model.joints]
    return _filter_by_prefix([f"{name}=" for name in names if name not in given], incomplete)


def complete_jogs(ctx: Any, incomplete: str) -> list[str]:  # noqa: ANN401
    """Return what can be jogged: the joints of the chosen arm, and directions of the tip."""
    model = _model_from_context(ctx)
    names = [] if model is None else [joint.name for joint in model.joints]
    return _filter_by_prefix([*names, *_DIRECTIONS], incomplete)


def complete_speeds(incomplete: str) -> list[str]:
    """Return the speed classes that start with a prefix."""
    return _filter_by_prefix(_SPEEDS, incomplete)


def complete_methods(incomplete: str) -> list[str]:
    """Return the methods of ``solve`` that start with a prefix."""
    from ikservo.ik import METHODS  # noqa: PLC0415

    return _filter_by_prefix(["auto", *METHODS], incomplete)


def complete_openings(incomplete: str) -> list[str]:
    """Return the commands of the gripper that start with a prefix."""
    return _filter_by_prefix(("open", "close"), incomplete)


def complete_actions(incomplete: str) -> list[str]:
    """Return the actions of ``ikservo calibration`` that start with a prefix."""
    names = ("diff", "push", "pull", "adopt", "resume", "revert")
    return _filter_by_prefix(names, incomplete)


def _filter_by_prefix(names: Iterable[str], incomplete: str) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]


def _model_from_context(ctx: Any) -> Model | None:  # noqa: ANN401
    """Return the arm of ``--arm`` or ``IKSERVO_ARM``; None if none is chosen yet."""
    from ikservo.errors import IkservoError  # noqa: PLC0415
    from ikservo.model import load_model  # noqa: PLC0415

    arm = ctx.params.get("arm") or os.environ.get("IKSERVO_ARM", "")
    try:
        return load_model(arm) if arm else None
    except IkservoError:
        return None


SpeedOption = Annotated[
    str, typer.Option("--speed", help="slow, normal or fast.", autocompletion=complete_speeds)
]
ToolSpeedOption = Annotated[
    float | None,
    typer.Option(
        "--tool-speed",
        parser=parse_tool_speed_m_s,
        metavar="MM/S",
        help="Constant speed of the tip on its path; default: as fast as --speed allows.",
    ),
]
Length = Annotated[float, typer.Argument(parser=parse_length_m, help="Metres, or like 120mm.")]
TipOption = Annotated[
    str | None,
    typer.Option("--tip", help="Link of the URDF that is the tool; needed for a .urdf file."),
]
ArmOption = Annotated[
    str | None,
    typer.Option(
        "--arm",
        envvar="IKSERVO_ARM",
        help="Arm: a name from `ikservo arms`, or a file.",
        autocompletion=complete_arms,
    ),
]
ArmArgument = Annotated[
    str | None,
    typer.Argument(
        metavar="[ARM]",
        envvar="IKSERVO_ARM",
        help="Arm: a name from `ikservo arms`, or a file.",
        autocompletion=complete_arms,
    ),
]
PortOption = Annotated[
    str | None,
    typer.Option(
        "--port",
        envvar="IKSERVO_PORT",
        help="Serial port, `sim` for a simulated arm, or zenoh:NAME@HOST of `ikservo serve`.",
    ),
]
ServoPortOption = Annotated[
    str | None,
    typer.Option(
        "--port",
        envvar="IKSERVO_PORT",
        help="Serial port of the servos, or `sim` for a simulated arm.",
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]
YesOption = Annotated[
    bool,
    typer.Option("--yes", "-y", help="Do not ask; needed to move a real arm without a terminal."),
]
DurationOption = Annotated[
    float | None,
    typer.Option("--duration", parser=parse_time_s, help="Duration; default: until Ctrl-C."),
]
CountOption = Annotated[
    int | None, typer.Option("--count", min=1, help="End after this many readings.")
]
OverwriteOption = Annotated[bool, typer.Option("--overwrite", help="Replace an existing file.")]
UncalibratedOption = Annotated[
    bool,
    typer.Option(
        "--uncalibrated", help="Use the arm file's nominal zeros instead of a calibration."
    ),
]


@dataclass(frozen=True, kw_only=True)
class ArmConnection:
    """The arm of a command, and where it is connected."""

    arm: ArmOption = None
    port: PortOption = None


@dataclass(frozen=True, kw_only=True)
class ServoConnection(ArmConnection):
    """The arm of a command that needs the servos at a port of this machine."""

    port: ServoPortOption = None


@dataclass(frozen=True, kw_only=True)
class NamedArmConnection(ArmConnection):
    """The arm as the first argument of a command, and where it is connected."""

    arm: ArmArgument = None


@dataclass(frozen=True, kw_only=True)
class NamedServoConnection(ArmConnection):
    """The arm as an argument, with its servos at a port of this machine."""

    arm: ArmArgument = None
    port: ServoPortOption = None


@dataclass(frozen=True, kw_only=True)
class MotionOptions:
    """How a command opens the arm, what it checks and asks before a motion, and its output.

    A command that offers only some of them says so with ``Without``.
    """

    collision: Annotated[
        bool,
        typer.Option(
            "--collision/--no-collision",
            help="Check the path for collisions; without it, the arm can hit itself.",
        ),
    ] = True
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Plan and print, but do not move.")] = (
        False
    )
    uncalibrated: UncalibratedOption = False
    no_wiggle: Annotated[
        bool,
        typer.Option(
            "--no-wiggle",
            help="Skip the 5° test of each joint after its arm file or calibration changed.",
        ),
    ] = False
    tip: TipOption = None
    yes: YesOption = False
    json: JsonOption = False


@dataclass(frozen=True, kw_only=True)
class ToolOptions:
    """The orientation of the tool."""

    pitch_rad: Annotated[
        float | None,
        typer.Option(
            "--pitch",
            parser=parse_angle_rad,
            metavar="DEG",
            help="Pitch of the tool; 0: level, -90: straight down.",
        ),
    ] = None
    roll_rad: Annotated[
        float | None,
        typer.Option(
            "--roll",
            parser=parse_angle_rad,
            metavar="DEG",
            help="Roll of the tool about its axis, clockwise seen from behind; 0: level.",
        ),
    ] = None
    direction: Annotated[
        str | None,
        typer.Option("--direction", metavar="X,Y,Z", help="Direction in which the tool points."),
    ] = None
    keep: Annotated[
        bool,
        typer.Option(
            "--keep", help="Keep the full orientation of the tool; refuse the motion if it cannot."
        ),
    ] = False

    def orientation(self) -> ToolOrientation:
        """Return the requested tool orientation.

        Raises:
            BadValueError: The options contradict each other, or an angle is too large.
        """
        from ikservo.arm.tool_orientation import ToolOrientation  # noqa: PLC0415  # loads the servo modules

        axis = None if self.direction is None else parse_axis(self.direction)
        return ToolOrientation(self.pitch_rad, self.roll_rad, axis, self.keep)
