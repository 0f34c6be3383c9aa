"""A calibration that was made on another adapter becomes that of the arm on this one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from ikservo.arm.calibrating.belonging import check_joints
from ikservo.arm.calibrating.by_hand import LooseArm
from ikservo.calibration.filing.calibration_file import read_calibration
from ikservo.calibration.filing.record import Calibration
from ikservo.calibration.filing.store import calibrations_of, save
from ikservo.calibration.in_servos.compare import contradictions_with
from ikservo.errors import CalibrationError

__all__ = ["adopt", "adoptable"]


def adoptable(loose: LooseArm, path: Path | None = None) -> tuple[Path, Calibration]:
    """Return the calibration that the servos on this line agree with, and where it lies.

    Args:
        loose: The arm.
        path: The file; None to look at what was made for this arm on other adapters.

    Raises:
        CalibrationError: None fits, or several do; says why.
        FileFormatError: The file is spoiled.
    """
    paths = [path] if path else [p for p in calibrations_of(loose.model.name) if p != loose.path]
    found = [(candidate, read_calibration(candidate)) for candidate in paths]
    doubts = {candidate: next(_doubts(loose, c), "") for candidate, c in found}
    fitting = [row for row in found if not doubts[row[0]]]
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        names = ", ".join(str(candidate) for candidate, _ in fitting)
        raise CalibrationError(f"Several calibrations fit: {names}.", "Choose one: --from FILE")
    reasons = " ".join(f"{p}: {doubt}" for p, doubt in doubts.items())
    raise CalibrationError(
        f"No calibration of another adapter fits this arm. {reasons}".rstrip(),
        f"Calibrate it: ikservo calibrate {loose.model.name}",
    )


def adopt(loose: LooseArm, calibration: Calibration) -> Path:
    """Save a calibration as that of the arm on this adapter; the one before is kept beside it."""
    own = {"usb_serial_number": loose.serial_number}
    return save(calibration.model_copy(update=own))


def _doubts(loose: LooseArm, calibration: Calibration) -> Iterator[str]:
    """Yield why a calibration cannot be this arm's."""
    if calibration.arm != loose.model.name:
        yield f"made for {calibration.arm}."
    try:
        check_joints(calibration, loose.model, "it")
    except CalibrationError as error:
        yield error.message
    yield from (f"{c}." for c in contradictions_with(calibration, loose.facts))
