"""Where LeRobot keeps its calibrations: by environment, kind of device and id."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

from ikservo.errors import InputError, UnknownNameError

__all__ = ["find_lerobot", "lerobot_roots"]

_ID = re.compile(r"[A-Za-z0-9_-]{1,64}")
_KINDS = ("robots", "teleoperators")


def find_lerobot(id_or_path: str) -> Path:
    """Return the file that an id or a path means.

    Ids are looked for below ``robots/<type>`` and ``teleoperators/<type>`` for every type, for
    LeRobot has renamed them: so100_follower, so101_follower, today so_follower.

    Raises:
        UnknownNameError: No such id; those that exist are listed.
        InputError: Several devices have that id; their files are listed.
    """
    if not _ID.fullmatch(id_or_path):
        return Path(id_or_path)
    found = [path for path in _files() if path.stem == id_or_path]
    if not found:
        raise UnknownNameError("LeRobot calibration", id_or_path, {p.stem for p in _files()})
    if len(found) > 1:
        listing = ", ".join(map(str, found))
        raise InputError(f"Several devices are called {id_or_path}.", f"Name one file: {listing}.")
    return found[0]


def lerobot_roots() -> list[Path]:
    """Return the folders in which LeRobot may keep calibrations, the most particular first."""
    own, home, hub = map(os.environ.get, ("HF_LEROBOT_CALIBRATION", "HF_LEROBOT_HOME", "HF_HOME"))
    roots = [Path(own)] if own else []
    roots += [Path(home) / "calibration"] if home else []
    roots += [Path(hub) / "lerobot" / "calibration"] if hub else []
    return [*roots, Path.home() / ".cache" / "huggingface" / "lerobot" / "calibration"]


def _files() -> Iterator[Path]:
    seen: set[Path] = set()
    for root in lerobot_roots():
        for kind in _KINDS:
            for path in sorted((root / kind).glob("*/*.json")):
                if path.resolve() not in seen and _ID.fullmatch(path.stem):
                    seen.add(path.resolve())
                    yield path
