"""Marks that ``ikservo stop`` leaves for programs that have not opened their port yet.

A stop counts for every program of this user that was started before it. A program that has an arm
open gets the stop through its control socket; a program that is still starting finds the mark when
it opens the port. Times are those of the machine's monotonic clock, which all its programs share.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator
from pathlib import Path

from ikservo.errors import IkservoError
from ikservo.serving.control_socket import make_private_directory, socket_path

_ANY_PORT = "stop://any"
# A stop does not apply to a program of the user that opens its first arm later than this.
_MAX_AGE_S = 600.0


def leave_mark(device: str = "", arm: str = "") -> None:
    """Stop running programs (all, or of one port or arm) before they move; ignore write errors."""
    path = _mark_path(device, arm)
    with contextlib.suppress(OSError, IkservoError):
        make_private_directory(path.parent)
        for old in path.parent.glob("*.stop"):
            if not any(_is_recent(at_s) for at_s in _read_mark(old)):
                old.unlink(missing_ok=True)
        new = path.with_suffix(f".{os.getpid()}.new")
        try:
            new.write_text(repr(time.monotonic()), "ascii")
            new.replace(path)
        finally:
            new.unlink(missing_ok=True)  # left empty on a full disk


def has_mark(device: str, arm: str) -> bool:
    """Check whether an arm at a port was stopped since this program was started.

    Stops before the last call of ``forget_marks`` do not count.
    """
    since_s = max(_started_s(), _forgotten_s)
    paths = {_mark_path(*key) for key in (("", ""), ("", arm), (device, arm), (device, ""))}
    return any(since_s <= at_s and _is_recent(at_s) for path in paths for at_s in _read_mark(path))


def forget_marks() -> None:
    """Ignore earlier stops for arms that this program opens next, because it has handled them."""
    global _forgotten_s  # noqa: PLW0603  # one value for the whole program
    _forgotten_s = time.monotonic()


_imported_s, _forgotten_s = time.monotonic(), 0.0


def _started_s() -> float:
    """Return the time when this program was started, on the monotonic clock, if known exactly.

    On systems that do not report it, the result is the time when this module was imported.
    """
    try:
        after_name = Path("/proc/self/stat").read_bytes().rpartition(b")")[2].split()
        since_boot_s = int(after_name[19]) / os.sysconf("SC_CLK_TCK")
        asleep_s = time.clock_gettime(time.CLOCK_BOOTTIME) - time.monotonic()
    except (AttributeError, IndexError, OSError, ValueError):  # not Linux
        return _imported_s
    return min(since_boot_s - asleep_s, _imported_s)


def _is_recent(at_s: float) -> bool:
    """Check the age of a mark; a mark from before a reboot may be in the future."""
    return 0.0 <= time.monotonic() - at_s <= _MAX_AGE_S


def _mark_path(device: str, arm: str) -> Path:
    return socket_path(device or _ANY_PORT, arm).with_suffix(".stop")


def _read_mark(path: Path) -> Iterator[float]:
    with contextlib.suppress(OSError, ValueError):
        yield float(path.read_text("ascii")[:64])
