"""``ikservo look``: find the point on the table that a pixel of the calibrated camera sees."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import typer

from ikservo.apps.cameras.camera_command import CameraNameOption
from ikservo.arm.opening import require_own_port
from ikservo.cli.motion_report import make_tip_motion, print_move_report
from ikservo.cli.open_and_confirm import open_from_options
from ikservo.cli.options import (
    MotionOptions,
    PathOptions,
    ServoConnection,
    SpeedOption,
    StraightOption,
    ToolOptions,
)
from ikservo.cli.quantities import parse_length_m, parse_pixels
from ikservo.cli.terminal import print_json, print_lines
from ikservo.errors import InputError, format_point
from ikservo.planning.motions import MoveTo

Pixel = Annotated[
    float, typer.Argument(parser=parse_pixels, help="Pixels, from the top left corner.")
]
Height = Annotated[
    float | None,
    typer.Option(
        "--height",
        parser=parse_length_m,
        metavar="LENGTH",
        help="Height of a plane above the table; default: whatever the pixel hits first.",
    ),
]
Camera = Annotated[
    str | None,
    typer.Option(
        "--camera",
        metavar="SOURCE",
        help="The camera, as in its calibration: a number, a device or an address.",
    ),
]
Move = Annotated[bool, typer.Option("--move", help="Move the tip to that point.")]


def command(
    u: Pixel,
    v: Pixel,
    *,
    connection: ServoConnection,
    height: Height = None,
    camera: Camera = None,
    camera_name: CameraNameOption = "",
    move: Move = False,
    speed: SpeedOption = "normal",
    tool: ToolOptions,
    straight: StraightOption = False,
    path: PathOptions,
    options: MotionOptions,
) -> None:
    """Print the point that the pixel U V of the calibrated camera sees; move there with --move.

    The point is in the arm's base frame. Without --height it is on the table or on the first thing
    of the scene. A camera that has moved is refused.

    ikservo look 480 360 --arm so101

    ikservo look 480 360 --height 30mm --move --pitch -90
    """
    within, orientation = path.within(), tool.orientation()
    if options.dry_run and not move:
        raise InputError("--dry-run only applies with --move.", "Add --move.")
    of_motion = (speed, tool, straight, replace(path, scene=None))
    if not move and of_motion != ("normal", ToolOptions(), False, PathOptions()):
        raise InputError("Motion options only apply with --move.", "Add --move.")
    with open_from_options(connection, options, path.scene) as machine:
        arm = require_own_port(machine)
        seeing = arm.camera.named(camera_name, camera)
        if height is None:
            seen = seeing.point_seen(u, v)
            point_m, thing = seen.point_m, seen.thing
        else:
            point_m, thing = seeing.point_on_table(u, v, height), None
        x, y, z = point_m.tolist()
        if not move:
            if options.json:
                print_json("look", pixel=[u, v], point_m=[x, y, z], thing=thing)
            else:
                on = f" on {thing}" if thing else ""
                print_lines([f"{format_point((x, y, z))}{on}"])
            return
        motion = MoveTo((x, y, z), speed=speed, stance=orientation, straight=straight,
                        within=within)  # fmt: skip
        report = make_tip_motion(machine, machine.plan(motion), options)
    print_move_report(report, json=options.json)
