"""Restore the calibration that is attached to a recording."""

from __future__ import annotations

from pathlib import Path

from ikservo.app_discovery import find_part
from ikservo.apps.calibrating.calibration_session import TorqueOffArm, find_mismatches
from ikservo.calibration.calibration_file import parse_calibration
from ikservo.calibration.records import Calibration
from ikservo.errors import CalibrationError


def read_recorded_calibration(path: Path) -> Calibration:
    """Read the calibration that is attached to a recording.

    Raises:
        CalibrationError: No calibration is attached.
        FileFormatError: The file is not an MCAP file, or the calibration is malformed.
    """
    text: str | None = find_part("import recording")(path)
    if text is None:
        raise CalibrationError(
            f"No calibration is attached to {path}.",
            "A calibration is attached when a calibrated arm is recorded as MCAP: ikservo "
            "record FILE.mcap",
        )
    return parse_calibration(path, text)


def check_adoptable(loose: TorqueOffArm, path: Path, calibration: Calibration) -> None:
    """Check that a calibration matches the servos on this bus.

    Raises:
        CalibrationError: The calibration does not match; the message says why.
    """
    reason = next(find_mismatches(loose, calibration), "")
    if reason:
        raise CalibrationError(
            f"The calibration in {path} does not fit this arm. {reason}",
            f"Calibrate it: ikservo calibrate {loose.model.name}",
        )
