"""``ikservo calibrate``: measure an arm's zeros, signs and ranges, with all options."""

from __future__ import annotations

import math
from typing import Annotated

import typer

from ikservo.app_discovery import find_part
from ikservo.apps.calibrating.by_hand_dialogue import CalibrationOptions, read_script
from ikservo.apps.calibrating.calibrate_auto import calibrate_auto
from ikservo.apps.calibrating.calibrate_by_hand import calibrate, parse_limits
from ikservo.apps.calibrating.calibrate_touch import TouchOffOptions, run_touch_off
from ikservo.apps.calibrating.touch_dialogue import read_touch_script
from ikservo.arm.opening import require_own_port
from ikservo.cli.camera_options import CameraOptions
from ikservo.cli.model_options import model_from_option
from ikservo.cli.open_and_confirm import open_from_options
from ikservo.cli.options import JsonOption, MotionOptions, NamedServoConnection, UncalibratedOption
from ikservo.cli.terminal_dialogue import AnswerOptions
from ikservo.cli.wiggle_prompt import check_directions
from ikservo.errors import InputError

Pose = Annotated[
    str, typer.Option("--pose", help="Named pose in which you hold the arm at the start.")
]
Margin = Annotated[
    float,
    typer.Option(
        "--margin", min=0.0, max=20.0, help="Degrees between each end stop and the limit."
    ),
]
Continuous = Annotated[
    list[str] | None,
    typer.Option("--continuous", metavar="JOINT", help="This joint has no end stops."),
]
Skip = Annotated[
    list[str] | None,
    typer.Option(
        "--skip",
        metavar="JOINT",
        help="Do not measure this joint; use the range and sign in the arm file.",
    ),
]
OnlyJoint = Annotated[
    list[str] | None,
    typer.Option("--joint", metavar="JOINT", help="Calibrate only this joint again."),
]
OwnLimit = Annotated[
    list[str] | None,
    typer.Option(
        "--limit",
        metavar="JOINT=LOW:HIGH",
        help="Range of a joint, narrower than the measured one.",
    ),
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
Auto = Annotated[bool, typer.Option("--auto", help="Let the arm drive gently to its end stops.")]
Wiggle = Annotated[
    bool, typer.Option("--wiggle", help="Move each joint by 5° and back, to check ids and signs.")
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
    touch_off: TouchOffOptions,
    camera: CameraOptions,
    uncalibrated: UncalibratedOption = False,
    answers: AnswerOptions,
    json: JsonOption = False,
) -> None:
    """Measure an arm's zeros, signs and ranges by hand, with torque off.

    ikservo calibrate so101

    ikservo calibrate so101 --pose home --margin 1 --write-limits

    ikservo calibrate so101 --joint elbow_flex        this joint again, keep the others

    ikservo calibrate so101 --auto          the arm finds its end stops

    ikservo calibrate so101 --touch         then touch a printed sheet, for millimetres

    ikservo calibrate so101 --camera 0      or show a printed board to a camera

    ikservo calibrate so101 --camera 0 --by-hand      the same, and you move the limp arm
    """
    seen = camera.camera is not None
    if auto + touch + wiggle + seen > 1:
        raise InputError("Only one of --auto, --touch, --camera and --wiggle can be given.")
    if joint and (auto or touch or seen):
        raise InputError("--joint can only be given in a calibration by hand, or with --wiggle.")
    of_limits = (pose, margin, continuous or None, skip or None, limit or None, write_limits)
    sets_limits = not (touch or wiggle or seen or camera.from_pictures)
    if not sets_limits and of_limits != ("rest", 2.0, None, None, None, None):
        raise InputError(
            "--pose, --margin, --continuous, --skip, --limit and --write-limits need a "
            "calibration that sets limits: by hand, or with --auto.",
            "Leave them out.",
        )
    if touch_off != TouchOffOptions() and not touch:
        raise InputError("--points, --same-point and --sheet-origin need --touch.", "Add: --touch")
    if uncalibrated and not wiggle:
        raise InputError("--uncalibrated needs --wiggle.", "Add --wiggle, or leave it out.")
    if camera.from_pictures is not None:
        if camera != CameraOptions(from_pictures=camera.from_pictures):
            raise InputError(
                "--from-pictures cannot be given with other camera options.", "Leave those out."
            )
        if auto or touch or wiggle or joint:
            raise InputError(
                "--from-pictures does not move the arm.", "Leave out the other procedures."
            )
        model = model_from_option(connection.arm)
        operator = answers.operator(read_script)
        from_pictures = find_part("calibrate --from-pictures")
        from_pictures(model, camera.from_pictures, operator, json=json)
        return
    if seen:
        by_camera = find_part("calibrate --camera")
        by_camera(connection, camera, answers.operator(read_script), json=json)
        return
    if camera != CameraOptions():
        hint = "Add --camera SOURCE, or leave them out to set the limits by hand."
        raise InputError("--by-hand and the options for boards and pictures need --camera.", hint)
    if wiggle:
        options = MotionOptions(collision=False, uncalibrated=uncalibrated)
        with open_from_options(connection, options) as machine:
            check_directions(require_own_port(machine), joint or [], yes=answers.yes, json=json)
        return
    model, port = model_from_option(connection.arm), connection.port
    operator = answers.operator(read_touch_script if touch else read_script)
    if touch:
        run_touch_off(model, port, touch_off, operator, json=json)
        return
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
