"""Where the calibrations of a person's arms lie: one file an arm and adapter."""

from __future__ import annotations

import re
from pathlib import Path

from ikservo.calibration.filing.calibration_file import read_calibration, text_of
from ikservo.calibration.filing.record import Calibration
from ikservo.files.writing import write_whole
from ikservo.hardware.line.remembered import config_folder

__all__ = [
    "calibration_path",
    "calibrations_of",
    "confirmation_path",
    "journal_path",
    "load",
    "partial_path",
    "save",
]

_FOREIGN = re.compile(r"[^A-Za-z0-9]+")
_LONGEST = 64


def calibration_path(arm: str, usb_serial_number: str) -> Path:
    """Return where the calibration of an arm on an adapter lies: ``arms/so101-58FA083.toml``."""
    return config_folder() / "arms" / f"{_stem(arm, usb_serial_number)}.toml"


def journal_path(arm: str, usb_serial_number: str) -> Path:
    """Return where it is noted what is being written into that arm's servos."""
    return config_folder() / "journal" / f"{_stem(arm, usb_serial_number)}.toml"


def confirmation_path(arm: str, usb_serial_number: str) -> Path:
    """Return where it is noted which files an arm's joints were last seen to obey."""
    return config_folder() / "confirmed" / f"{_stem(arm, usb_serial_number)}.txt"


def partial_path(arm: str, usb_serial_number: str) -> Path:
    """Return where the joints are kept that an interrupted self-calibration has measured."""
    return config_folder() / "partial" / f"{_stem(arm, usb_serial_number)}.toml"


def calibrations_of(arm: str) -> list[Path]:
    """Return the calibrations of an arm on any adapter, by name."""
    folder = config_folder() / "arms"
    return sorted({*folder.glob(f"{_part(arm)}.toml"), *folder.glob(f"{_part(arm)}-*.toml")})


def load(arm: str, usb_serial_number: str) -> Calibration | None:
    """Return the calibration of an arm on an adapter, or None where there is none.

    Raises:
        FileFormatError: There is one and it is spoiled.
    """
    path = calibration_path(arm, usb_serial_number)
    return read_calibration(path) if path.exists() else None


def save(calibration: Calibration) -> Path:
    """Write a calibration to its place; the one before is kept beside it.

    Raises:
        FileWriteError: The disk will not take it; the one before still stands.
    """
    path = calibration_path(calibration.arm, calibration.usb_serial_number)
    write_whole(path, text_of(calibration), keep_old=True)
    return path


def _stem(arm: str, usb_serial_number: str) -> str:
    serial = _part(usb_serial_number)
    return f"{_part(arm)}-{serial}" if serial else _part(arm)


def _part(text: str) -> str:
    """Return a text as a part of a file name that leads nowhere else."""
    return _FOREIGN.sub("_", text).strip("_")[:_LONGEST]
