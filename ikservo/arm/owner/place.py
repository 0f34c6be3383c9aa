"""Where the owner of a bus listens: a folder that only its user may enter, one name a device."""

from __future__ import annotations

import hashlib
import os
import stat
import tempfile
from pathlib import Path

from ikservo.errors import IkservoError

__all__ = ["make_folder", "place_of", "places"]

# What fits into an address on every system: 104 bytes on macOS, 108 on Linux.
_LONGEST_PATH = 100


def place_of(device: str) -> Path:
    """Return where the owner of a device listens; all names of one device lead to one place."""
    real = device if "://" in device else str(Path(device).resolve())
    name = hashlib.sha256(real.encode()).hexdigest()[:16]
    place = _folder() / f"{name}.sock"
    return place if len(os.fsencode(place)) <= _LONGEST_PATH else _short(place)


def places() -> list[Path]:
    """Return every place at which an owner of this user listens, or listened before it died."""
    near, short = _folder(), _short(_folder() / "x")
    prefix = short.name.removesuffix("x")
    return sorted({*near.glob("*.sock"), *short.parent.glob(f"{prefix}*.sock")})


def make_folder(folder: Path) -> None:
    """Make the folder, open to its user alone.

    Raises:
        IkservoError: It is somebody else's, or no folder at all.
    """
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != _user():
        raise IkservoError(f"{folder} is not a folder of this user.", "Remove it.")
    if stat.S_IMODE(found.st_mode) != 0o700:
        folder.chmod(0o700)


def _folder() -> Path:
    own = os.environ.get("IKSERVO_HOME")
    if own:
        return Path(own).resolve() / "run"
    session = os.environ.get("XDG_RUNTIME_DIR")
    if session:
        return Path(session) / "ikservo"
    return Path(tempfile.gettempdir()) / f"ikservo-run-{_user()}"


def _short(place: Path) -> Path:
    """Return a place near the root for one whose path is too long for an address."""
    folder = hashlib.sha256(os.fsencode(place.parent)).hexdigest()[:16]
    return Path(tempfile.gettempdir()) / f"ikservo-{_user()}" / f"{folder}-{place.name}"


def _user() -> int:
    return os.getuid() if hasattr(os, "getuid") else 0
