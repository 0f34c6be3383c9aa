"""Options that commands share, most of them in groups."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ikservo.cli.completion import complete_arms, complete_from
from ikservo.cli.quantities import (
    parse_angle_rad,
    parse_axis,
    parse_coordinate_m,
    parse_length_m,
    parse_point_m,
    parse_time_s,
    parse_tool_speed_m_s,
)

if TYPE_CHECKING:
    from ikservo.planning.path_constraint import PathConstraint
    from ikservo.planning.tool_orientation import ToolOrientation


def angle_option(name: str, text: str) -> Any:  # noqa: ANN401  # like typer.Option
    """Return an option for an angle, in degrees by default."""
    return typer.Option(name, parser=parse_angle_rad, metavar="DEG", help=text)


SpeedOption = Annotated[
    str,
    typer.Option(
        "--speed",
        help="slow, normal or fast.",
        autocompletion=complete_from("slow", "normal", "fast"),
    ),
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
Length = Annotated[
    float,
    typer.Argument(parser=parse_coordinate_m, help="In metres, or with a unit, such as 120mm."),
]
TipOption = Annotated[
    str | None,
    typer.Option("--tip", help="Name of the tool link in the URDF; required with a .urdf file."),
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
StraightOption = Annotated[
    bool, typer.Option("--straight", help="Refuse a motion instead of moving around obstacles.")
]
ThinkOption = Annotated[
    float,
    typer.Option(
        "--think", parser=parse_time_s, help="Longest time to search for a path around obstacles."
    ),
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
    """The arm of a command, and its port."""

    arm: ArmOption = None
    port: PortOption = None


@dataclass(frozen=True, kw_only=True)
class ServoConnection(ArmConnection):
    """The arm of a command that needs the servos on a port of this machine."""

    port: ServoPortOption = None


@dataclass(frozen=True, kw_only=True)
class NamedArmConnection(ArmConnection):
    """The arm as the first argument of a command, and its port."""

    arm: ArmArgument = None


@dataclass(frozen=True, kw_only=True)
class NamedServoConnection(ArmConnection):
    """The arm as the first argument, with its servos on a port of this machine."""

    arm: ArmArgument = None
    port: ServoPortOption = None


@dataclass(frozen=True, kw_only=True)
class MotionOptions:
    """Options for opening the arm, for checks and questions before a motion, and for output.

    A command that offers only some of them excludes the others with ``Without``.
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
            help="Skip the 5° test of each joint after the arm file or calibration has changed.",
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
        angle_option("--pitch", "Pitch of the tool: 0 is level, -90 points straight down."),
    ] = None
    roll_rad: Annotated[
        float | None,
        angle_option(
            "--roll", "Roll of the tool about its axis, clockwise as seen from behind; 0 is level."
        ),
    ] = None
    direction: Annotated[
        str | None,
        typer.Option("--direction", metavar="X,Y,Z", help="Direction in which the tool points."),
    ] = None
    keep: Annotated[
        bool,
        typer.Option(
            "--keep",
            help="Keep the full orientation of the tool; refuse the motion if that is impossible.",
        ),
    ] = False
    within_rad: Annotated[
        float | None,
        angle_option(
            "--within", "Largest error allowed in pitch, roll or direction; default: 0.5."
        ),
    ] = None

    def orientation(self) -> ToolOrientation:
        """Return the requested tool orientation.

        Raises:
            BadValueError: The options contradict each other, or an angle is too large.
        """
        from ikservo.planning.tool_orientation import ToolOrientation  # noqa: PLC0415  # loads the servo modules

        axis = None if self.direction is None else parse_axis(self.direction)
        turned = (self.pitch_rad, self.roll_rad, axis, self.keep)
        return ToolOrientation(*turned, within_rad=self.within_rad)


SceneOption = Annotated[
    Path | None,
    typer.Option("--scene", metavar="FILE", help="TOML file with the things around the arm."),
]


@dataclass(frozen=True, kw_only=True)
class PathOptions:
    """Things around the arm, and constraints on the tool during the whole motion."""

    scene: SceneOption = None
    upright_rad: Annotated[
        float | None,
        angle_option(
            "--upright",
            "Largest tilt, during the motion, of an object that is upright now, such as a cup.",
        ),
    ] = None
    keep_axis: Annotated[
        str | None,
        typer.Option(
            "--keep-axis",
            metavar="X,Y,Z:DEG",
            help="Direction of the tool axis during the motion, and the largest error allowed.",
        ),
    ] = None
    keep_in: Annotated[
        str | None,
        typer.Option(
            "--keep-in",
            metavar="X,Y,Z:X,Y,Z",
            help="Lowest and highest corner of a box in which the tip stays.",
        ),
    ] = None
    keep_above: Annotated[
        str | None,
        typer.Option(
            "--keep-above",
            metavar="Z",
            help="Height above which the tip stays; or a point and an upward direction.",
        ),
    ] = None

    def within(self) -> PathConstraint:
        """Return the constraints on the tool during the motion.

        Raises:
            BadValueError: The lower corner is not below the upper one, or a number is out of range.
        """
        from ikservo.planning.path_constraint import PathConstraint  # noqa: PLC0415  # as above

        given: dict[str, object] = {"upright_rad": self.upright_rad}
        if self.keep_axis is not None:
            axis, angle = _halves("--keep-axis", self.keep_axis)
            given |= {"axis": parse_axis(axis), "axis_rad": parse_angle_rad(angle)}
        if self.keep_in is not None:
            low, high = _halves("--keep-in", self.keep_in)
            given |= {"low_m": parse_point_m(low), "high_m": parse_point_m(high)}
        if self.keep_above is not None and ":" in self.keep_above:
            point, normal = _halves("--keep-above", self.keep_above)
            given |= {"above_m": parse_point_m(point), "normal": parse_axis(normal)}
        elif self.keep_above is not None:
            given["above_m"] = (0.0, 0.0, parse_length_m(self.keep_above))
        return PathConstraint(**given)  # pyright: ignore[reportArgumentType]


def _halves(option: str, text: str) -> tuple[str, str]:
    first, colon, second = text.partition(":")
    if not colon:
        raise typer.BadParameter(f"{option} needs two parts separated by a colon, not {text!r}.")
    return first, second


PointsOption = Annotated[
    Path | None,
    typer.Option("--points", metavar="FILE", help="Points to touch, one NAME X Y Z per line."),
]
