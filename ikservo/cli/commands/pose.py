"""``ikservo pose``: move all joints to a named pose."""

from __future__ import annotations

from typing import Annotated

import typer

from ikservo.arm.networks import find_network
from ikservo.arm.opening import resolve_port
from ikservo.cli.commands.joints import make_joint_motion, print_report
from ikservo.cli.completion import complete_poses
from ikservo.cli.model_options import model_from_option
from ikservo.cli.open_and_confirm import open_from_options
from ikservo.cli.option_groups import Without
from ikservo.cli.options import (
    ArmConnection,
    MotionOptions,
    PathOptions,
    SpeedOption,
    StraightOption,
    ThinkOption,
)
from ikservo.cli.terminal import print_json, print_lines, print_status, print_table
from ikservo.errors import NoPortError
from ikservo.hardware.port_names import remembered_serial_number, serial_number_of
from ikservo.model import arm_names, load_model
from ikservo.planning.motions import THINK_S, MoveJoints
from ikservo.planning.poses import PoseLibrary

Name = Annotated[
    str | None,
    typer.Argument(
        metavar="NAME", help="rest, home, zero, or a taught pose.", autocompletion=complete_poses
    ),
]


def command(
    name: Name = None,
    *,
    connection: ArmConnection,
    speed: SpeedOption = "normal",
    straight: StraightOption = False,
    think: ThinkOption = THINK_S,
    path: PathOptions,
    options: Annotated[MotionOptions, Without("tip")],
) -> None:
    """Move to a pose of the arm file or to one you taught; without a name, list them.

    ikservo pose home --arm so101 --port sim

    ikservo pose                            the poses of all arms
    """
    if name is None:
        _list_poses(connection, json=options.json)
        return
    with open_from_options(connection, options, path.scene) as machine:
        inside = machine.pose_within_limits(name)
        for words in inside.changed:
            print_status(f"{words}.")
        motion = MoveJoints(inside.positions, speed=speed, straight=straight,
                            within=path.within(), think_s=think)  # fmt: skip
        report = make_joint_motion(machine, motion, options)
    print_report(report, machine.model, json=options.json)


def _list_poses(connection: ArmConnection, *, json: bool) -> None:
    if not (connection.arm or connection.port):
        libraries = {
            model.name: PoseLibrary(model, remembered_serial_number(model.name))
            for model in map(load_model, arm_names())
        }
        if json:
            found = [
                {"name": name, "poses": library.all_poses(), "taught": sorted(library.user_poses())}
                for name, library in libraries.items()
            ]
            print_json("poses-of-arms", arms=found)
        else:
            rows = [[name, ", ".join(library.all_poses())] for name, library in libraries.items()]
            print_table(["arm", "poses"], rows)
    elif find_network(connection.port):
        with open_from_options(connection) as machine:
            _print_poses(machine.poses, json=json)
    else:
        model = model_from_option(connection.arm)
        try:
            serial_number = serial_number_of(resolve_port(model, connection.port))
        except NoPortError:  # the poses taught on its most recent adapter are listed
            serial_number = remembered_serial_number(model.name)
        _print_poses(PoseLibrary(model, serial_number), json=json)


def _print_poses(poses: PoseLibrary, *, json: bool) -> None:
    if json:
        print_json("poses", poses=poses.all_poses(), taught=sorted(poses.user_poses()))
    else:
        print_lines(poses.all_poses())
