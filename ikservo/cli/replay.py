"""``ikservo replay``: a recorded motion once more, through the guard."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from ikservo.arm.tapes.replaying import ReplayReport, playback_of
from ikservo.cli.calibrating.wiggle import check_once
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
from ikservo.cli.output import note, point, print_json, print_lines
from ikservo.cli.session import agree, opened, watched

__all__ = ["command"]

File = Annotated[Path, typer.Argument(metavar="FILE", help="What `ikservo record` wrote.")]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Read and check it, but do not move.")]


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
    """Go to the first pose of a recording, then along it, as fast as recorded where it may.

    ikservo replay wave.jsonl --arm so101 --port sim
    """
    with opened(arm, port, collisions=collision, uncalibrated=uncalibrated) as machine:
        machine.zeros.check(machine.model.name)
        machine.model.speed(speed)
        recording, playback = playback_of(machine.workings, file, speed)
        slower = (
            f", {playback.slower:.1f} times slower than recorded" if playback.slower > 1 else ""
        )
        note(f"{machine.model.title} on {machine.port_name}: {len(recording.times_s)} samples, "
             f"{playback.duration_s:.1f} s{slower}.")  # fmt: skip
        if dry_run:
            if json:
                print_json("replay_plan", samples=len(recording.times_s),
                           duration_s=playback.duration_s, slower=playback.slower)  # fmt: skip
            return
        agree(machine, yes=yes)
        if not no_wiggle:
            check_once(machine, yes=yes)
        with watched() as draw:
            report = machine.replay(file, speed=speed, on_progress=draw)
    _print(report, json=json)


def _print(report: ReplayReport, *, json: bool) -> None:
    if json:
        print_json(
            "replay",
            samples=report.samples,
            duration_s=report.duration_s,
            slower=report.slower,
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
            f"tip       {point(report.measured_tip_m.tolist())}",
        ]
    )
