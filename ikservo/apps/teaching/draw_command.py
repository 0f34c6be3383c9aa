"""``ikservo draw``: move the tip along the strokes of an SVG or CSV file."""

from __future__ import annotations

from pathlib import Path
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
)
from ikservo.cli.quantities import parse_angle_rad, parse_length_m, parse_point_m
from ikservo.cli.terminal import print_status
from ikservo.errors import BadValueError, format_point
from ikservo.files.drawing import read_drawing
from ikservo.planning.motions import Draw

File = Annotated[
    Path, typer.Argument(metavar="FILE", help="An .svg, or CSV with x,y or x,y,z in each line.")
]
Origin = Annotated[
    str | None,
    typer.Option(
        "--origin",
        metavar="X,Y,Z",
        help="Position of the drawing's lower left corner (SVG) or origin (CSV); default: the "
        "current tip position.",
    ),
]
Scale = Annotated[float | None, typer.Option("--scale", help="Factor for all lengths in the file.")]
Width = Annotated[
    float | None,
    typer.Option(
        "--width",
        parser=parse_length_m,
        metavar="LENGTH",
        help="Length of the larger side of the drawing, instead of --scale.",
    ),
]
Rotate = Annotated[
    float | None,
    typer.Option(
        "--rotate",
        parser=parse_angle_rad,
        metavar="DEG",
        help="Rotation of the drawing about its origin.",
    ),
]
Unit = Annotated[
    str | None,
    typer.Option("--unit", help="Unit of a CSV without a unit in its header: m or mm; default: m."),
]
Lift = Annotated[
    float,
    typer.Option(
        "--lift",
        parser=parse_length_m,
        metavar="LENGTH",
        help="Height to lift the tip between strokes; default: 10mm.",
        show_default=False,
    ),
]


def command(
    file: File,
    *,
    origin: Origin = None,
    scale: Scale = None,
    width: Width = None,
    rotate: Rotate = None,
    unit: Unit = None,
    lift: Lift = 0.01,
    connection: ArmConnection,
    speed: SpeedOption = "normal",
    tool_speed: ToolSpeedOption = None,
    tool: ToolOptions,
    path: PathOptions,
    options: MotionOptions,
) -> None:
    """Move the tip along the strokes of a file, lifted between them.

    An SVG has its own size (one pixel is 1/96 inch); its right side is to the right of the arm, and
    its top is away from the arm. Each line of a CSV has x,y or x,y,z along the axes of the base
    frame; an empty line ends a stroke. Lengths are in metres, or in the unit that the header gives:
    x_mm,y_mm.

    ikservo draw star.svg --origin 0.18,0.04,0.05 --width 80mm --arm so101 --port sim

    ikservo draw path.csv --unit mm --origin 0.2,0,0.1 --tool-speed 30 --dry-run
    """
    if scale is not None and width is not None:
        raise BadValueError("The size of the drawing", "given twice", "either --scale or --width")
    drawing = read_drawing(file, unit)
    if width is not None:
        drawing = drawing.with_width(width)
    drawing = drawing.scaled(1.0 if scale is None else scale).simplified()
    orientation = tool.orientation()
    origin_m = None if origin is None else parse_point_m(origin)
    with open_from_options(connection, options, path.scene) as machine:
        origin_m = origin_m or tuple(machine.where().tip_m.tolist())
        placed = drawing.placed(origin_m, rotate or 0.0)
        motion = Draw(placed.strokes_m, lift_m=lift, tool_speed_m_s=tool_speed,
                      speed=speed, stance=orientation, within=path.within())  # fmt: skip
        plan = machine.plan(motion)
        along_x, along_y = (1000.0 * side_m for side_m in placed.size_m)
        count = len(placed.strokes_m)
        print_status(
            f"{count} stroke{'s' if count > 1 else ''}, {along_x:.0f} mm along x and "
            f"{along_y:.0f} mm along y, origin at {format_point(origin_m)}."
        )
        for what in placed.ignored:
            print_status(f"Not drawn: {what}.")
        report = make_tip_motion(machine, plan, options)
    print_move_report(report, json=options.json)
