"""``ikservo export``: export this arm's calibration, or recordings, for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ikservo.apps.teaching.dataset import export_dataset
from ikservo.apps.teaching.recorder import read_recording
from ikservo.calibration.calibration_file import read_calibration
from ikservo.calibration.lerobot import dump_lerobot, lerobot_joints, lost_in_lerobot
from ikservo.calibration.paths import calibration_path, calibrations_of
from ikservo.cli.completion import complete_from
from ikservo.cli.model_options import model_from_option
from ikservo.cli.options import ServoConnection
from ikservo.cli.terminal import print_status, print_text
from ikservo.errors import CalibrationError, InputError, UnknownNameError
from ikservo.files.writing import write_atomic
from ikservo.hardware.port_names import serial_number_of
from ikservo.model import Model

FORMATS = ("lerobot", "csv", "dataset")
Kind = Annotated[
    str,
    typer.Argument(
        metavar="lerobot|csv|dataset",
        help="Format: lerobot, csv or dataset.",
        autocompletion=complete_from(*FORMATS),
    ),
]
Sources = Annotated[
    list[Path] | None,
    typer.Argument(
        metavar="[RECORDING]...", help="Recordings: one for csv, the episodes for dataset."
    ),
]
To = Annotated[
    Path | None,
    typer.Option("--to", metavar="FILE", help="File to write, or folder of the data set."),
]
Fps = Annotated[
    int | None, typer.Option("--fps", min=1, max=500, help="Frames per second of a data set.")
]
Task = Annotated[
    str, typer.Option("--task", metavar="TEXT", help="Description of the task, for a data set.")
]


def command(
    kind: Kind,
    recordings: Sources = None,
    *,
    connection: ServoConnection,
    to: To = None,
    fps: Fps = None,
    task: Task = "",
) -> None:
    """Print a calibration as LeRobot JSON or a recording as CSV; write recordings as a data set.

    Values that LeRobot's file cannot hold are listed on stderr.

    ikservo export lerobot --arm so101 > my_arm.json

    ikservo export csv wave.jsonl > wave.csv

    ikservo export dataset one.jsonl two.jsonl --arm so101 --to my_set --task "wave"
    """
    if kind == "csv":
        if not recordings or len(recordings) != 1:
            count = "Several recordings are" if recordings else "No recording is"
            raise InputError(f"{count} given.", "Name one: ikservo export csv wave.jsonl")
        _write_output(read_recording(recordings[0]).to_csv(), to)
    elif kind == "dataset":
        export_dataset(model_from_option(connection.arm), recordings or [], to, fps, task)
    elif kind == "lerobot":
        model = model_from_option(connection.arm)
        calibration = read_calibration(_find_calibration_file(model, connection.port))
        text = dump_lerobot(lerobot_joints(calibration))
        for line in lost_in_lerobot(calibration):
            print_status(line)
        _write_output(text, to)
    else:
        raise UnknownNameError("format", kind, FORMATS)


def _write_output(text: str, to: Path | None) -> None:
    if to:
        write_atomic(to, text, keep_old=True)
    else:
        print_text(text)


def _find_calibration_file(model: Model, port: str | None) -> Path:
    """Find the calibration file of the arm on a port, or the only file that exists."""
    found = calibrations_of(model.name)
    if port:
        found = [
            path for path in found if path == calibration_path(model.name, serial_number_of(port))
        ]
    if not found:
        raise CalibrationError(
            f"{model.name} is not calibrated.", f"Calibrate it: ikservo calibrate {model.name}"
        )
    if len(found) > 1:
        listing = ", ".join(path.name for path in found)
        raise InputError(
            f"Several {model.name} arms are calibrated: {listing}.", "Choose one with --port."
        )
    return found[0]
