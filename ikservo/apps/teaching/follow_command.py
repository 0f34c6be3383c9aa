"""``ikservo follow``: follow a leader arm that is guided by hand."""

from __future__ import annotations

from typing import Annotated

import typer

from ikservo.arm import open_arm
from ikservo.cli.completion import complete_arms
from ikservo.cli.open_and_confirm import confirm_motion, open_from_options, warn_uncompiled
from ikservo.cli.option_groups import Without
from ikservo.cli.options import ArmConnection, DurationOption, MotionOptions, SpeedOption
from ikservo.cli.results import Field, Fields, print_fields
from ikservo.cli.terminal import format_port, print_status
from ikservo.cli.wiggle_prompt import check_directions_once
from ikservo.errors import format_point
from ikservo.model import load_model
from ikservo.planning.reports import FollowResult

Leader = Annotated[
    str,
    typer.Argument(
        metavar="LEADER",
        help="Arm that you guide by hand: a name or a file.",
        autocompletion=complete_arms,
    ),
]
LeaderPort = Annotated[str | None, typer.Option("--leader-port", help="Serial port of the leader.")]


def _count_targets(report: FollowResult) -> str:
    if not report.refused:
        return str(report.setpoints)
    reason = f"{report.reason[:1].lower()}{report.reason[1:]}".rstrip(".")
    return f"{report.setpoints}, rejected {report.refused}{f' ({reason})' if reason else ''}"


_FIELDS: Fields[FollowResult] = (
    Field("setpoints", "targets", _count_targets),
    Field("unreached"),
    Field("refused"),
    Field("reason"),
    Field("ended", "ended"),
    Field("measured_rad"),
    Field("measured_tip_m", "tip", lambda report: format_point(report.measured_tip_m)),
    Field("warnings"),
    Field("duration_s", "duration", lambda report: f"{report.duration_s:.2f} s"),
)
_LINES = "ended setpoints measured_tip_m duration_s"


def command(
    leader: Leader,
    *,
    connection: ArmConnection,
    leader_port: LeaderPort = None,
    speed: SpeedOption = "fast",
    duration: DurationOption = None,
    options: Annotated[MotionOptions, Without("dry_run", "tip")],
) -> None:
    """Follow an arm that you guide by hand, joint by joint; Ctrl-C stops.

    Joints are matched by name. The leader's torque stays off. This arm keeps its limits and speed.

    ikservo follow so101 --leader-port /dev/ttyACM1 --arm so101 --port /dev/ttyACM0
    """
    model = load_model(leader)
    with (
        open_arm(model, leader_port, uncalibrated=options.uncalibrated) as leading,
        open_from_options(connection, options) as machine,
    ):
        print_status(
            f"{machine.model.title} on {format_port(machine.port_name)} follows "
            f"{leading.model.title} on {format_port(leading.port_name)}; Ctrl-C stops."
        )
        if any(state.torque for state in leading.where().joints):
            print_status(
                "The leader's torque is on. Switch it off with: "
                f"ikservo relax --arm {leading.model.name} --port {leading.port_name}"
            )
        warn_uncompiled()
        confirm_motion(machine, yes=options.yes)
        check_directions_once(machine, options)
        end_s = None if duration is None else machine.clock.now_s() + duration
        report = machine.follow_arm(
            leading, speed=speed, until=lambda: end_s is not None and machine.clock.now_s() >= end_s
        )
    print_fields("follow", report, _FIELDS, json=options.json, order=_LINES)
