"""Facts about an arm's camera besides its calibration, such as whether it has moved."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from ikservo.calibration.calibration_file import load_calibration
from ikservo.calibration.paths import camera_path
from ikservo.calibration.records import CalibratedCamera, SeenBoard
from ikservo.files.reading import MAX_BYTES, parse_toml, read_text
from ikservo.files.validation import StrictModel
from ikservo.files.writing import checked_toml, strip_checksum, write_atomic

SIMULATED = "sim"
"""Key of a simulated arm, which has no adapter with a serial number."""

_HEADER = "# Facts about an arm's camera that are not in its calibration; written by ikservo.\n"

NotBelowZero = Annotated[float, Field(ge=0)]


class CameraCheck(StrictModel):
    """The result of the last check whether the camera has moved: table ``[check]``."""

    seen: datetime = Field(description="a date and time with UTC offset")
    off_mm: NotBelowZero = Field(description="millimetres across the ray, at the board")
    moved_mm: NotBelowZero = Field(description="millimetres")
    turned_deg: NotBelowZero = Field(description="degrees")
    has_moved: bool = Field(description="true or false")


class CameraFile(StrictModel):
    """The content of the file; entries from an earlier calibration of the camera are ignored."""

    format: Literal[1] = Field(default=1, description="1")
    calibrated: datetime = Field(description="when the camera was calibrated")
    check: CameraCheck | None = Field(default=None, description="a table [check]")
    board: SeenBoard | None = Field(
        default=None, description="a table [board], of a board that lies on the table"
    )
    camera: CalibratedCamera | None = Field(
        default=None, description="a table [camera], for a simulated arm, which has no calibration"
    )


def camera_names(arm: str, usb_serial_number: str) -> list[str]:
    """Return the names of an arm's cameras; empty for a camera without a name.

    Raises:
        FileFormatError: The calibration is damaged.
    """
    if usb_serial_number != SIMULATED:
        calibration = load_calibration(arm, usb_serial_number)
        return sorted(calibration.cameras_by_name) if calibration else []
    path = camera_path(arm, usb_serial_number)
    named = path.parent.glob(f"{path.stem}.*.toml")
    return [""] * path.exists() + sorted(each.stem.rpartition(".")[2] for each in named)


def load_camera(
    arm: str, usb_serial_number: str, name: str = ""
) -> tuple[CalibratedCamera, CameraFile] | None:
    """Load a camera with which an arm was calibrated; None if no camera has the name.

    Raises:
        FileFormatError: A file is damaged.
    """
    path = camera_path(arm, usb_serial_number, name)
    known = None
    if path.exists():
        tables = parse_toml(path, strip_checksum(path, read_text(path, MAX_BYTES)))
        known = CameraFile.from_tables(tables, path)
    if usb_serial_number == SIMULATED:
        camera = None if known is None else known.camera
    else:
        calibration = load_calibration(arm, usb_serial_number)
        camera = None if calibration is None else calibration.cameras_by_name.get(name)
    if camera is None:
        return None
    if known is None or known.calibrated != camera.seen:
        known = CameraFile(calibrated=camera.seen)
    return camera, known


def save_camera(arm: str, usb_serial_number: str, known: CameraFile, name: str = "") -> Path:
    """Write the facts about a camera.

    Raises:
        FileWriteError: The disk is full or not writable; the file is unchanged.
    """
    path = camera_path(arm, usb_serial_number, name)
    write_atomic(path, checked_toml(_HEADER, known.model_dump(mode="python", exclude_none=True)))
    return path
