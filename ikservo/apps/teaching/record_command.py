"""``ikservo record``: record the joint positions at a fixed rate to a file."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from ikservo.apps.teaching.live_view import FOXGLOVE_PORT
from ikservo.apps.teaching.recorder import RecordSettings, record_other_process
from ikservo.arm import OpenArm
from ikservo.cli.model_options import model_from_option
from ikservo.cli.open_and_confirm import open_from_options
from ikservo.cli.options import (
    ArmConnection,
    DurationOption,
    JsonOption,
    MotionOptions,
    OverwriteOption,
    UncalibratedOption,
)
from ikservo.cli.quantities import parse_time_s
from ikservo.cli.terminal import confirm, print_json, print_lines, print_status
from ikservo.errors import InputError

File = Annotated[
    Path, typer.Argument(metavar="FILE", help="New file: .mcap, or any other name for JSON lines.")
]
Period = Annotated[
    float,
    typer.Option(
        "--period",
        parser=parse_time_s,
        help="Time between two samples; default: 20ms.",
        show_default=False,
    ),
]
Foxglove = Annotated[
    bool, typer.Option("--foxglove", help="Also show the arm live in Foxglove on this machine.")
]
FoxglovePort = Annotated[
    int, typer.Option("--foxglove-port", min=1, max=65535, help="TCP port for --foxglove.")
]

_JSON_LINES = (".jsonl", ".json", ".ndjson")


def command(
    file: File,
    *,
    connection: ArmConnection,
    duration: DurationOption = None,
    period: Period = 0.02,  # pyright: ignore[reportArgumentType]
    overwrite: OverwriteOption = False,
    foxglove: Foxglove = False,
    foxglove_port: FoxglovePort = FOXGLOVE_PORT,
    uncalibrated: UncalibratedOption = False,
    json: JsonOption = False,
) -> None:
    """Record the joints while you guide the limp arm, or while another program moves it.

    ikservo record wave.jsonl --arm so101

    ikservo record wave.mcap --foxglove --arm so101     ROS 2 messages, shown live

    ikservo replay wave.jsonl --arm so101
    """
    if duration is None and not sys.stdin.isatty():
        raise InputError(
            "Cannot wait for Ctrl-C, because input is not a terminal.",
            "Add --duration, as in --duration 10.",
        )
    model = model_from_option(connection.arm)
    until = _first_sample_announcer() if duration is None else None
    live = foxglove_port if foxglove else None
    settings = RecordSettings(file, duration, until, period, overwrite, live)
    report = record_other_process(model, connection.port, settings)
    if report is None:
        with open_from_options(connection, MotionOptions(uncalibrated=uncalibrated)) as machine:
            _offer_release(machine)
            report = machine.record(file, duration_s=duration, until=until, period_s=period,
                                    overwrite=overwrite, foxglove_port=live)  # fmt: skip
    if json:
        print_json("record", path=str(report.path), samples=report.samples,
                   duration_s=report.duration_s)  # fmt: skip
    else:
        print_lines([f"{report.samples} samples in {report.duration_s:.2f} s: {report.path}"])
    if file.suffix not in _JSON_LINES and file.suffix != ".mcap":
        print_status(f"{file.name} has JSON lines; for ROS 2 messages, record to a .mcap file.")


def _offer_release(machine: OpenArm) -> None:
    """Warn that an arm with torque on cannot be guided by hand, and offer to switch torque off."""
    if not any(state.torque for state in machine.where().joints):
        return
    print_status("Torque is on, so the arm cannot be guided by hand.")
    if sys.stdin.isatty() and machine.zeros.are_known:
        if confirm("Lower the arm to its rest pose and switch torque off first?"):
            machine.relax()
    else:
        print_status("To switch torque off: ikservo relax")


def _first_sample_announcer() -> Callable[[], bool]:
    """Return an ``until`` callback that prints a message at the first sample."""
    announced = False

    def never_ends() -> bool:
        nonlocal announced
        if not announced:
            print_status("Recording; Ctrl-C ends it.")
        announced = True
        return False

    return never_ends
