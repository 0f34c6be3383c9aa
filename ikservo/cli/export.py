"""``ikservo export``: this arm's calibration, or a recording, for another program."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ikservo.arm import read_recording
from ikservo.calibration.calibration_file import read_calibration
from ikservo.calibration.lerobot import dump_lerobot, lerobot_joints, lost_in_lerobot
from ikservo.calibration.paths import calibration_path, calibrations_of
from ikservo.cli.model_options import model_from_option
from ikservo.cli.options import ArmOption, PortOption
from ikservo.cli.terminal import print_status
from ikservo.errors import CalibrationError, InputError, UnknownNameError
from ikservo.files.writing import write_atomic
from ikservo.hardware.remembered_port import serial_number_of
from ikservo.model import Model

__all__ = ["command"]

Kind = Annotated[str, typer.Argument(metavar="lerobot|csv", help="Format: lerobot or csv.")]
Source = Annotated[
    Path | None, typer.Argument(metavar="[RECORDING]", help="The recording, for csv.")
]
To = Annotated[
    Path | None, typer.Option("--to", metavar="FILE", help="Write a file instead of stdout.")
]


def command(
    kind: Kind,
    recording: Source = None,
    *,
    arm: ArmOption = None,
    port: PortOption = None,
    to: To = None,
) -> None:
    """Print a calibration as LeRobot's JSON, or a recording as CSV.

    What LeRobot's file cannot hold is listed on stderr.

    ikservo export lerobot --arm so101 > my_arm.json

    ikservo export csv wave.jsonl > wave.csv
    """
    if kind == "csv":
        _write_output(_recording_csv(recording), to)
    elif kind == "lerobot":
        _write_output(_lerobot_text(model_from_option(arm), port), to)
    else:
        raise UnknownNameError("format", kind, ("lerobot", "csv"))


def _recording_csv(recording: Path | None) -> str:
    if recording is None:
        raise InputError("No recording given.", "Name it: ikservo export csv wave.jsonl")
    return read_recording(recording).to_csv()


def _lerobot_text(model: Model, port: str | None) -> str:
    calibration = read_calibration(_find_calibration_file(model, port))
    text = dump_lerobot(lerobot_joints(calibration))
    for line in lost_in_lerobot(calibration):
        print_status(line)
    return text


def _write_output(text: str, to: Path | None) -> None:
    if to:
        write_atomic(to, text, keep_old=True)
    else:
        typer.echo(text, nl=False)  # byte for byte as in a file


def _find_calibration_file(model: Model, port: str | None) -> Path:
    """Return the calibration of the arm on a port, or the only one that exists."""
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
            f"Several {model.name} are calibrated: {listing}.", "Choose one with --port."
        )
    return found[0]
