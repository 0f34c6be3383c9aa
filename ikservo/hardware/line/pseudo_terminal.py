"""Telling a pseudo-terminal from a serial adapter: behind the one there is a program."""

from __future__ import annotations

import os
import re
import stat
import sys
from pathlib import Path

__all__ = ["is_pseudo_terminal"]

_LINUX_MAJORS = range(136, 144)  # Documentation/admin-guide/devices.txt: Unix98 PTY slaves
_MACOS_NAME = re.compile(r"/dev/ttys\d+")


def is_pseudo_terminal(port_name: str) -> bool:
    """Return whether a port's name, links followed, is one end of a pseudo-terminal."""
    path = Path(port_name)
    try:
        device, mode = path.stat().st_rdev, path.stat().st_mode
        if sys.platform == "linux":
            return stat.S_ISCHR(mode) and os.major(device) in _LINUX_MAJORS
        return _MACOS_NAME.fullmatch(str(path.resolve())) is not None
    except (OSError, ValueError):
        return False
