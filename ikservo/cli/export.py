"""``ikservo export``: this arm's calibration for another program."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ikservo.arm.own import serial_number_of
from ikservo.calibration.filing.calibration_file import read_calibration
from ikservo.calibration.filing.lerobot import dump_lerobot, lerobot_joints, unsaid
from ikservo.calibration.filing.store import calibration_path, calibrations_of
from ikservo.cli.choosing import chosen_model
from ikservo.cli.import_ import Kind, check_kind
from ikservo.cli.options import ArmOption, PortOption
from ikservo.cli.output import note
from ikservo.errors import CalibrationError, InputError
from ikservo.files.writing import write_whole
from ikservo.model import Model

__all__ = ["command"]

To = Annotated[
    Path | None, typer.Option("--to", metavar="FILE", help="Write a file instead of stdout.")
]


def command(kind: Kind, *, arm: ArmOption = None, port: PortOption = None, to: To = None) -> None:
    """Print a calibration as LeRobot's JSON; says on stderr what that cannot tell.

    ikservo export lerobot --arm so101 > my_arm.json
    """
    check_kind(kind)
    calibration = read_calibration(_path(chosen_model(arm), port))
    text = dump_lerobot(lerobot_joints(calibration))
    for line in unsaid(calibration):
        note(line)
    if to:
        write_whole(to, text, keep_old=True)
    else:
        typer.echo(text, nl=False)  # byte for byte as LeRobot writes it


def _path(model: Model, port: str | None) -> Path:
    """Return the calibration of the arm on a port, or the only one there is."""
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
        raise InputError(f"Several {model.name} are calibrated: {listing}.", "Name one by --port.")
    return found[0]
