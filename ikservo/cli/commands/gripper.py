"""``ikservo gripper``: open, close, or move to a width, and report whether it grasped."""

from __future__ import annotations

from typing import Annotated

import typer

from ikservo.app_discovery import find_part
from ikservo.arm import OpenArm
from ikservo.cli.completion import complete_from
from ikservo.cli.open_and_confirm import confirm_motion, motion_progress_bar, open_from_options
from ikservo.cli.option_groups import Without
from ikservo.cli.options import ArmConnection, MotionOptions, SceneOption
from ikservo.cli.quantities import parse_length_m
from ikservo.cli.results import Field, Fields, print_fields
from ikservo.cli.terminal import format_port, print_status
from ikservo.errors import ExitCode, InputError
from ikservo.planning.motions import MoveGripper
from ikservo.planning.reports import GraspResult

To = Annotated[
    str | None,
    typer.Argument(
        metavar="open|close|WIDTH",
        help="open, close, or a width such as 30mm.",
        autocompletion=complete_from("open", "close"),
    ),
]
Force = Annotated[
    float | None,
    typer.Option(
        "--force",
        help="Fraction of the servo's torque: 0.05 (7.4 V STS3215: 0.1) to 1; default: 0.3.",
    ),
]


Weigh = Annotated[
    bool, typer.Option("--weigh", help="Weigh the object in the jaws; moves the arm slowly.")
]


def command(
    to: To = None,
    *,
    connection: ArmConnection,
    force: Force = None,
    weigh: Weigh = False,
    scene: SceneOption = None,
    options: Annotated[MotionOptions, Without("collision", "dry_run", "no_wiggle", "tip")],
) -> None:
    """Open or close the gripper; it stops at an object between its jaws and holds it.

    ikservo gripper close --force 0.2 --arm so101 --port sim

    ikservo gripper 30mm --arm px100 --port sim

    ikservo gripper --weigh --arm so101       weighs the object, after `ikservo identify`
    """
    if weigh == (to is not None):
        raise InputError(
            "--weigh cannot be used with a motion of the jaws."
            if weigh
            else "No motion of the jaws was given.",
            "Give open, close, a width such as 30mm, or --weigh.",
        )
    if to is None:
        find_part("gripper --weigh")(connection, options)
        return
    width_m = None if to.isalpha() else parse_length_m(to)
    motion = MoveGripper(to if width_m is None else None, width_m=width_m, force=force)
    with open_from_options(connection, options, scene) as machine:
        print_status(f"{machine.model.title} on {format_port(machine.port_name)}: gripper {to}.")
        confirm_motion(machine, yes=options.yes)
        with motion_progress_bar() as on_progress:
            report = machine.execute(motion, on_progress)
    print_fields("gripper", report, _fields(machine), json=options.json, order=_LINES)
    if not (report.reached or report.grasped):
        raise typer.Exit(ExitCode.FAILED)


_LINES = "grasped position_rad reached duration_s"


def _fields(machine: OpenArm) -> Fields[GraspResult]:
    gripper = machine.model.gripper
    format_position = machine.model.joint(gripper.joint).joint_map.format if gripper else str

    def describe_jaws(report: GraspResult) -> str:
        width = "" if report.width_m is None else f", jaws {report.width_m * 1000:z.1f} mm apart"
        load = "" if report.load_percent is None else f", load {report.load_percent:z.0f} %"
        return f"{format_position(report.position_rad)}{width}{load}"

    return (
        Field("grasped", "grasped"),
        Field("reached", "reached"),
        Field("position_rad", "gripper", describe_jaws),
        Field("width_m"),
        Field("load_percent"),
        Field("force"),
        Field("duration_s", "duration", lambda report: f"{report.duration_s:.2f} s"),
    )
