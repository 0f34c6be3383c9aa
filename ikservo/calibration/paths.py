"""Paths of an arm's calibration and related files, by adapter."""

from __future__ import annotations

import re
from datetime import datetime
from pathlib import Path

from ikservo.files.reading import config_dir

_UNSAFE_CHARS = re.compile(r"[^A-Za-z0-9]+")
_MAX_NAME_CHARS = 64


def calibration_path(arm: str, usb_serial_number: str) -> Path:
    """Return an arm's calibration file: ``arms/so101-58FA083.toml``."""
    return config_dir() / "arms" / f"{_file_stem(arm, usb_serial_number)}.toml"


def identified_path(arm: str, usb_serial_number: str) -> Path:
    """Return the file of an identified arm: ``identified/so101-58FA083.toml``."""
    return config_dir() / "identified" / f"{_file_stem(arm, usb_serial_number)}.toml"


def camera_path(arm: str, usb_serial_number: str, name: str = "") -> Path:
    """Return the file of a camera that sees an arm: ``cameras/so101-58FA083.toml``.

    A camera with a name has its own file: ``cameras/so101-58FA083.left.toml``.
    """
    stem = _file_stem(arm, usb_serial_number)
    return config_dir() / "cameras" / (f"{stem}.{name}.toml" if name else f"{stem}.toml")


def journal_path(arm: str, usb_serial_number: str) -> Path:
    """Return the journal of an interrupted write to an arm's servos."""
    return config_dir() / "journal" / f"{_file_stem(arm, usb_serial_number)}.toml"


def confirmation_path(arm: str, usb_serial_number: str) -> Path:
    """Return the file that records the last confirmation of the arm's joints."""
    return config_dir() / "confirmed" / f"{_file_stem(arm, usb_serial_number)}.txt"


def partial_path(arm: str, usb_serial_number: str) -> Path:
    """Return the file of the joints measured by an interrupted self-calibration."""
    return config_dir() / "partial" / f"{_file_stem(arm, usb_serial_number)}.toml"


def journals_of(arm: str) -> list[Path]:
    """Return the journals of interrupted writes to one arm on any adapter, or else to all arms."""
    folder = config_dir() / "journal"
    return _files_of(folder, arm) if arm else sorted(folder.glob("*.toml"))


def pictures_path(arm: str, began: datetime) -> Path:
    """Return the folder with the pictures of an incomplete calibration."""
    return config_dir() / "pictures" / f"{_file_stem(arm, '')}-{began:%Y%m%d-%H%M%S}"


def calibrations_of(arm: str) -> list[Path]:
    """Return the calibrations of an arm on any adapter, by name."""
    return _files_of(config_dir() / "arms", arm)


def identified_of(arm: str) -> list[Path]:
    """Return the identification files of an arm on any adapter, by name."""
    return _files_of(config_dir() / "identified", arm)


def _files_of(folder: Path, arm: str) -> list[Path]:
    name = _safe_name_part(arm)
    return sorted({*folder.glob(f"{name}.toml"), *folder.glob(f"{name}-*.toml")})


def _file_stem(arm: str, usb_serial_number: str) -> str:
    serial = _safe_name_part(usb_serial_number)
    return f"{_safe_name_part(arm)}-{serial}" if serial else _safe_name_part(arm)


def _safe_name_part(text: str) -> str:
    """Convert text to a part of a file name that cannot refer to another folder."""
    return _UNSAFE_CHARS.sub("_", text).strip("_")[:_MAX_NAME_CHARS]
