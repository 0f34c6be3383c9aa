"""Which adapter each arm was last found on, by USB serial number: one small file a user.

``ports.toml`` in the user's configuration folder::

    format = 1

    [serial_numbers]
    so101 = "58FA0834561"
"""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import cast

__all__ = ["config_folder", "remember", "remembered_serial_number"]

_FILE = "ports.toml"
_FORMAT = 1


def config_folder() -> Path:
    """Return the folder of the user's own files: ``IKSERVO_HOME``, or where the system has it."""
    own = os.environ.get("IKSERVO_HOME")
    if own:
        return Path(own)
    from platformdirs import user_config_path  # noqa: PLC0415  # only where it is needed

    return user_config_path("ikservo", appauthor=False)


def remembered_serial_number(arm: str) -> str:
    """Return the serial number of the adapter an arm was last found on, or nothing."""
    return _serial_numbers().get(arm, "")


def remember(arm: str, serial_number: str) -> None:
    """Remember an arm's adapter; where the folder cannot be written, nothing is remembered."""
    known = _serial_numbers()
    if serial_number and known.get(arm) != serial_number:
        with contextlib.suppress(OSError):  # a comfort must not stop an arm
            _write({**known, arm: serial_number})


def _serial_numbers() -> dict[str, str]:
    try:
        tables = tomllib.loads((config_folder() / _FILE).read_text("utf-8"))
    except (OSError, ValueError):  # not there, or spoiled: as good as new
        return {}
    found = tables.get("serial_numbers")
    if tables.get("format") != _FORMAT or not isinstance(found, dict):
        return {}
    rows = cast("dict[str, object]", found)
    return {arm: number for arm, number in rows.items() if isinstance(number, str)}


def _write(numbers: Mapping[str, str]) -> None:
    """Replace the file in one step, so that no reader meets half of it."""
    folder = config_folder()
    folder.mkdir(parents=True, exist_ok=True)
    rows = [f"{json.dumps(arm)} = {json.dumps(number)}" for arm, number in sorted(numbers.items())]
    text = "\n".join([f"format = {_FORMAT}", "", "[serial_numbers]", *rows, ""])
    with tempfile.NamedTemporaryFile("w", dir=folder, delete=False, encoding="utf-8") as file:
        file.write(text)
    Path(file.name).replace(folder / _FILE)
