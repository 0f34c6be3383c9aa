"""``ikservo arc``: move the tip on an arc through a point to an end, or on a circle."""

from __future__ import annotations

import math
from typing import Annotated

import typer

from ikservo.cli.motion_report import make_tip_motion, print_move_report
from ikservo.cli.open_and_confirm import open_from_options
from ikservo.cli.options import (
    ArmConnection,
    MotionOptions,
    PathOptions,
    SpeedOption,
    ToolOptions,
    ToolSpeedOption,
    angle_option,
)
from ikservo.cli.quantities import parse_axis, parse_coordinate_m, parse_point_m
from ikservo.planning.motions import MoveArc

OptionalLength = Annotated[
    float | None,
    typer.Argument(
        parser=parse_coordinate_m, help="End point, in metres or with a unit, such as 120mm."
    ),
]
Via = Annotated[str | None, typer.Option("--via", metavar="X,Y,Z", help="Point on the arc.")]
FullCircle = Annotated[
    bool,
    typer.Option("--full-circle", help="Continue past the end, back to the start of the circle."),
]
Center = Annotated[
    str | None,
    typer.Option(
        "--center", "--centre", metavar="X,Y,Z", help="Centre of the arc, instead of X Y Z."
    ),
]
Normal = Annotated[
    str,
    typer.Option(
        "--normal",
        metavar="AXIS",
        help="With --center: axis of the circle, x, y, z or three numbers.",
    ),
]
Angle = Annotated[
    float | None,
    angle_option("--angle", "With --center: angle of the arc; default: 360; negative: clockwise."),
]


def command(
    x: OptionalLength = None,
    y: OptionalLength = None,
    z: OptionalLength = None,
    *,
    via: Via = None,
    full_circle: FullCircle = False,
    center: Center = None,
    normal: Normal = "z",
    angle: Angle = None,
    connection: ArmConnection,
    speed: SpeedOption = "normal",
    tool_speed: ToolSpeedOption = None,
    tool: ToolOptions,
    path: PathOptions,
    options: MotionOptions,
) -> None:
    """Move the tip on an arc through --via to X Y Z, or about --center.

    ikservo arc 0.20 -0.05 0.15 --via 0.25,0,0.15 --arm so101 --port sim

    ikservo arc 0.20 -0.05 0.15 --via 0.25,0,0.15 --full-circle --tool-speed 50

    ikservo arc --center 0.2,0,0.15 --normal z --angle -180
    """
    via_m = None if via is None else parse_point_m(via)
    end_m = None
    if x is not None:
        if y is None or z is None:
            raise typer.BadParameter("The end of the arc needs X Y Z.")
        end_m = (x, y, z)
    motion = MoveArc(
        via_m,
        end_m,
        full_circle=full_circle,
        center_m=None if center is None else parse_point_m(center),
        normal=parse_axis(normal),
        angle_rad=math.tau if angle is None else angle,
        tool_speed_m_s=tool_speed,
        speed=speed,
        stance=tool.orientation(),
        within=path.within(),
    )
    with open_from_options(connection, options, path.scene) as machine:
        report = make_tip_motion(machine, machine.plan(motion), options)
    print_move_report(report, json=options.json)
