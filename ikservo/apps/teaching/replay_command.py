"""``ikservo replay``: replay a recorded motion, checked by the guard."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from ikservo.cli.open_and_confirm import confirm_motion, motion_progress_bar, open_from_options
from ikservo.cli.option_groups import Without
from ikservo.cli.options import ArmConnection, MotionOptions, SceneOption, SpeedOption
from ikservo.cli.results import Field, Fields, print_fields
from ikservo.cli.terminal import format_port, print_json, print_status
from ikservo.cli.wiggle_prompt import check_directions_once
from ikservo.errors import format_point
from ikservo.planning.reports import ReplayResult

File = Annotated[Path, typer.Argument(metavar="FILE", help="File that `ikservo record` wrote.")]


@dataclass(frozen=True, kw_only=True)
class ReplayOptions(MotionOptions):
    """The options of the motion; a dry run only reads the recording."""

    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Read and check the recording, but do not move.")
    ] = False


_FIELDS: Fields[ReplayResult] = (
    Field("samples", "samples"),
    Field("duration_s", "duration", lambda report: f"{report.duration_s:.2f} s"),
    Field("slowdown"),
    Field(
        "error_rad",
        "error",
        lambda report: f"{math.degrees(report.error_rad):.2f}° at most from the last sample",
    ),
    Field("measured_rad"),
    Field("measured_tip_m", "tip", lambda report: format_point(report.measured_tip_m)),
)


def command(
    file: File,
    *,
    connection: ArmConnection,
    speed: SpeedOption = "normal",
    scene: SceneOption = None,
    options: Annotated[ReplayOptions, Without("tip")],
) -> None:
    """Move to the first pose of a recording, then repeat it, at most at the recorded speed.

    ikservo replay wave.jsonl --arm so101 --port sim
    """
    with open_from_options(connection, options, scene) as machine:
        recording, playback = machine.load_replay(file, speed=speed)
        slowdown = (
            f", {playback.slowdown:.1f} times slower than recorded" if playback.slowdown > 1 else ""
        )
        print_status(
            f"{machine.model.title} on {format_port(machine.port_name)}: "
            f"{len(recording.times_s)} samples, {playback.duration_s:.1f} s{slowdown}."
        )
        if options.dry_run:
            if options.json:
                print_json("replay-plan", samples=len(recording.times_s),
                           duration_s=playback.duration_s, slowdown=playback.slowdown)  # fmt: skip
            return
        confirm_motion(machine, yes=options.yes)
        check_directions_once(machine, options)
        with motion_progress_bar() as on_progress:
            report = machine.replay(file, speed=speed, on_progress=on_progress)
    print_fields("replay", report, _FIELDS, json=options.json)
