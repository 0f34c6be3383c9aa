"""``ikservo replay``: replay a recorded motion, checked by the guard."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from ikservo.arm.reports import ReplayResult
from ikservo.cli.direction_check import check_directions_once
from ikservo.cli.options import (
    ArmOption,
    CollisionOption,
    JsonOption,
    NoWiggleOption,
    PortOption,
    SpeedOption,
    UncalibratedOption,
    YesOption,
)
from ikservo.cli.session import confirm_motion, motion_progress_bar, open_from_options
from ikservo.cli.terminal import format_port, print_json, print_lines, print_status
from ikservo.errors import format_point

__all__ = ["command"]

File = Annotated[Path, typer.Argument(metavar="FILE", help="File that `ikservo record` wrote.")]
DryRun = Annotated[
    bool, typer.Option("--dry-run", help="Read and check the recording, but do not move.")
]


def command(
    file: File,
    *,
    arm: ArmOption = None,
    port: PortOption = None,
    speed: SpeedOption = "normal",
    collision: CollisionOption = True,
    dry_run: DryRun = False,
    uncalibrated: UncalibratedOption = False,
    no_wiggle: NoWiggleOption = False,
    yes: YesOption = False,
    json: JsonOption = False,
) -> None:
    """Move to the first pose of a recording, then repeat it, at most at the recorded speed.

    ikservo replay wave.jsonl --arm so101 --port sim
    """
    with open_from_options(arm, port, collisions=collision, uncalibrated=uncalibrated) as machine:
        recording, playback = machine.load_replay(file, speed=speed)
        slowdown = (
            f", {playback.slowdown:.1f} times slower than recorded" if playback.slowdown > 1 else ""
        )
        print_status(
            f"{machine.model.title} on {format_port(machine.port_name)}: "
            f"{len(recording.times_s)} samples, {playback.duration_s:.1f} s{slowdown}."
        )
        if dry_run:
            if json:
                print_json("replay-plan", samples=len(recording.times_s),
                           duration_s=playback.duration_s, slowdown=playback.slowdown)  # fmt: skip
            return
        confirm_motion(machine, yes=yes)
        if not no_wiggle:
            check_directions_once(machine, yes=yes)
        with motion_progress_bar() as on_progress:
            report = machine.replay(file, speed=speed, on_progress=on_progress)
    _print_replay_report(report, json=json)


def _print_replay_report(report: ReplayResult, *, json: bool) -> None:
    if json:
        print_json(
            "replay",
            samples=report.samples,
            duration_s=report.duration_s,
            slowdown=report.slowdown,
            error_rad=report.error_rad,
            measured_rad=report.measured_rad,
            measured_tip_m=report.measured_tip_m,
        )
        return
    print_lines(
        [
            f"samples   {report.samples}",
            f"duration  {report.duration_s:.2f} s",
            f"error     {math.degrees(report.error_rad):.2f}° of the last sample at most",
            f"tip       {format_point(report.measured_tip_m)}",
        ]
    )
