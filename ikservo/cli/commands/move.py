"""``ikservo move``: move the tip to a point, on a line or through points; or look at a point."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import typer

from ikservo.cli.commands.joints import make_joint_motion, print_report
from ikservo.cli.model_options import PostureOptions, report_missing_freedom
from ikservo.cli.motion_report import make_tip_motion, print_move_report
from ikservo.cli.open_and_confirm import open_from_options, plan_motion
from ikservo.cli.options import (
    ArmConnection,
    Length,
    MotionOptions,
    PathOptions,
    SpeedOption,
    StraightOption,
    ThinkOption,
    ToolOptions,
    ToolSpeedOption,
)
from ikservo.cli.quantities import parse_length_m, parse_point_m
from ikservo.errors import InputError
from ikservo.planning.motions import THINK_S, LookAt, MoveThrough, MoveTo

Line = Annotated[bool, typer.Option("--line", help="Move the tip on a straight line.")]
Via = Annotated[
    list[str] | None,
    typer.Option("--via", metavar="X,Y,Z", help="Point to pass without stopping; repeatable."),
]
Blend = Annotated[
    float,
    typer.Option(
        "--blend",
        parser=parse_length_m,
        metavar="LENGTH",
        help="Largest distance at which the tip passes a --via point; default: 20mm.",
        show_default=False,
    ),
]
LookAtOption = Annotated[
    bool, typer.Option("--look-at", help="Point the tool at X Y Z; the tip may move.")
]


def command(
    x: Length,
    y: Length,
    z: Length,
    *,
    connection: ArmConnection,
    speed: SpeedOption = "normal",
    look_at: LookAtOption = False,
    line: Line = False,
    via: Via = None,
    blend: Blend = 0.02,
    tool_speed: ToolSpeedOption = None,
    tool: ToolOptions,
    preferred: PostureOptions,
    straight: StraightOption = False,
    think: ThinkOption = THINK_S,
    path: PathOptions,
    options: MotionOptions,
) -> None:
    """Move the tip to the point X Y Z in the arm's base frame.

    The tool keeps its orientation as far as the arm can, unless you request another one.

    ikservo move 0.25 0.05 0.15 --arm so101 --port sim

    ikservo move 250mm -50mm 0.15 --line --pitch -60

    ikservo move 0.25 0 0.15 --prefer wrist_roll=90 --prefer wrist_flex=0 --weight wrist_flex=0.5

    ikservo move 0.25 0.05 0.15 --line --tool-speed 50

    ikservo move 0.2 0.1 0.1 --via 0.2,0,0.2 --via 0.25,0.05,0.2 --blend 30mm

    ikservo move 0.2 0.1 0.1 --upright 10 --scene table.toml

    ikservo move --look-at 1 0.5 0.3
    """
    within = path.within()
    if straight and (line or via or tool_speed is not None):
        raise InputError(
            "--straight cannot be used with --line, --via or --tool-speed.", "Leave out --straight."
        )
    if look_at:
        others = {"--line": line, "--via": via, "--tool-speed": tool_speed}
        others |= {"--pitch": tool.pitch_rad, "--roll": tool.roll_rad}
        others |= {"--direction": tool.direction, "--keep": tool.keep}
        others |= {"--within": tool.within_rad}
        others |= {"--upright": path.upright_rad, "--keep-axis": path.keep_axis}
        others |= {"--keep-in": path.keep_in, "--keep-above": path.keep_above}
        others |= {"--straight": straight, "--think": think if think != THINK_S else None}
        others |= {"--prefer": preferred.prefer, "--weight": preferred.weight}
        given = [name for name, value in others.items() if value not in (None, False, [])]
        if given:
            raise InputError(
                f"--look-at cannot be given with {', '.join(given)}.", "Leave the others out."
            )
        with open_from_options(connection, options, path.scene) as machine:
            looked = make_joint_motion(machine, LookAt((x, y, z), speed=speed), options)
            print_report(looked, machine.model, json=options.json)
        return
    orientation = tool.orientation()
    points = [*(parse_point_m(text) for text in via or ()), (x, y, z)]
    with open_from_options(connection, options, path.scene) as machine:
        posture = preferred.posture(machine.model, machine.chain)
        orientation = orientation if posture is None else replace(orientation, posture=posture)
        if via or line or tool_speed is not None:
            motion = MoveThrough(points, blend_m=blend, line=line, tool_speed_m_s=tool_speed,
                                 speed=speed, stance=orientation, within=within)  # fmt: skip
        else:
            motion = MoveTo((x, y, z), speed=speed, stance=orientation, straight=straight,
                            within=within, think_s=think)  # fmt: skip
        plan = plan_motion(machine, motion)
        if posture is not None and plan.solution is not None:
            report_missing_freedom(machine.chain, plan.solution.q, directed=False)
        report = make_tip_motion(machine, plan, options)
    print_move_report(report, json=options.json)
