"""``ikservo calibrate``: measure an arm's zeros, signs and ranges; options of all its variants."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from ikservo.cli.calibrate_auto import calibrate_auto
from ikservo.cli.calibrate_by_hand import calibrate, parse_limits
from ikservo.cli.calibrate_touch import TouchOffOptions, run_touch_off
from ikservo.cli.dialogue import Operator
from ikservo.cli.direction_check import check_directions
from ikservo.cli.model_options import model_from_option
from ikservo.cli.options import (
    JsonOption,
    MotionOptions,
    NamedServoConnection,
    UncalibratedOption,
    YesOption,
    parse_length_m,
)
from ikservo.cli.session import open_from_options
from ikservo.errors import InputError
from ikservo.maintenance.calibration_dialogue import CalibrationOptions, read_script
from ikservo.maintenance.touch_dialogue import read_touch_script

__all__ = [
    "Auto",
    "BlockHeight",
    "Continuous",
    "FromScript",
    "Margin",
    "NoInput",
    "OnlyJoint",
    "OwnLimit",
    "Points",
    "Pose",
    "SamePoint",
    "SheetOrigin",
    "Skip",
    "TouchOff",
    "Wiggle",
    "WriteLimits",
    "command",
]


Pose = Annotated[str, typer.Option("--pose", help="Named pose in which you hold the arm at first.")]
Margin = Annotated[
    float,
    typer.Option(
        "--margin", min=0.0, max=20.0, help="Degrees between each end stop and the limit."
    ),
]
FromScript = Annotated[
    Path | None,
    typer.Option("--from-script", metavar="FILE", help="File with the answers, one per line."),
]
NoInput = Annotated[bool, typer.Option("--no-input", help="Never ask; a question is an error.")]
Continuous = Annotated[
    list[str] | None,
    typer.Option("--continuous", metavar="JOINT", help="This joint has no end stops."),
]
Skip = Annotated[
    list[str] | None,
    typer.Option("--skip", metavar="JOINT", help="Use the arm file's range and sign."),
]
OnlyJoint = Annotated[
    list[str] | None,
    typer.Option("--joint", metavar="JOINT", help="Calibrate only this joint again."),
]
OwnLimit = Annotated[
    list[str] | None,
    typer.Option("--limit", metavar="JOINT=LOW:HIGH", help="Narrower range of your own."),
]
WriteLimits = Annotated[
    bool | None,
    typer.Option(
        "--write-limits/--no-write-limits", help="Write the limits into the servos as well."
    ),
]

TouchOff = Annotated[
    bool,
    typer.Option("--touch", help="Touch-off: measure zeros, links and base by touching points."),
]
Points = Annotated[
    Path | None,
    typer.Option("--points", metavar="FILE", help="Points to touch, one NAME X Y Z per line."),
]
SamePoint = Annotated[
    bool, typer.Option("--same-point", help="Touch one fixed point of unknown position repeatedly.")
]
SheetOrigin = Annotated[
    float | None,
    typer.Option(
        "--sheet-origin",
        parser=parse_length_m,
        help="Distance from the base to the near edge of the sheet.",
    ),
]
BlockHeight = Annotated[
    float | None,
    typer.Option(
        "--block-height", parser=parse_length_m, help="Height of a block for every other cross."
    ),
]
Auto = Annotated[bool, typer.Option("--auto", help="Let the arm drive gently to its end stops.")]
Wiggle = Annotated[
    bool,
    typer.Option("--wiggle", help="Move each joint by 5° and back, to check ids and signs."),
]


def command(
    connection: NamedServoConnection,
    *,
    pose: Pose = "rest",
    margin: Margin = 2.0,
    continuous: Continuous = None,
    skip: Skip = None,
    joint: OnlyJoint = None,
    limit: OwnLimit = None,
    write_limits: WriteLimits = None,
    auto: Auto = False,
    wiggle: Wiggle = False,
    touch: TouchOff = False,
    points: Points = None,
    same_point: SamePoint = False,
    sheet_origin: SheetOrigin = None,
    block_height: BlockHeight = None,
    uncalibrated: UncalibratedOption = False,
    from_script: FromScript = None,
    yes: YesOption = False,
    no_input: NoInput = False,
    json: JsonOption = False,
) -> None:
    """Measure an arm's zeros, signs and ranges by hand, with torque off.

    ikservo calibrate so101

    ikservo calibrate so101 --pose home --margin 1 --write-limits

    ikservo calibrate so101 --joint elbow_flex        this joint again, keep the others

    ikservo calibrate so101 --auto          the arm finds its end stops

    ikservo calibrate so101 --touch         then touch a printed sheet, for millimetres
    """
    if auto + touch + wiggle > 1:
        raise InputError("One of --auto, --touch and --wiggle at a time.")
    if joint and (auto or touch):
        raise InputError("--joint goes with a calibration by hand or with --wiggle.")
    if wiggle:
        options = MotionOptions(collision=False, uncalibrated=uncalibrated)
        with open_from_options(connection, options) as machine:
            check_directions(machine, joint or [], yes=yes, json=json)
        return
    model, port = model_from_option(connection.arm), connection.port
    entries = None
    if from_script:
        entries = (read_touch_script if touch else read_script)(from_script)
    operator = Operator.of(entries, yes=yes, no_input=no_input)
    if touch:
        touch_options = TouchOffOptions(points, same_point, sheet_origin, block_height)
        run_touch_off(model, port, touch_options, operator, json=json)
        return
    if points or same_point or sheet_origin is not None or block_height is not None:
        raise InputError("Points are touched in a touch-off only.", "Add: --touch")
    user = parse_limits(model, limit or [])
    options = CalibrationOptions(
        pose=pose,
        margin_rad=math.radians(margin),
        continuous=continuous or [],
        skip=skip or [],
        joints=[model.joint(name).name for name in joint or []],
        user=user,
        write_limits=write_limits,
    )
    (calibrate_auto if auto else calibrate)(model, port, options, operator, json=json)
