"""The baud rate a client has set on a pseudo-terminal, also those without a name."""

from __future__ import annotations

import fcntl
import struct
import sys
import termios

__all__ = ["line_speed"]

_TCGETS2 = 0x802C542A  # Linux, asm-generic/ioctls.h
_TERMIOS2 = struct.Struct("4IB19s2I")  # four flag words, discipline, characters, both speeds
_NAMED = {
    getattr(termios, name): int(name[1:])
    for name in dir(termios)
    if name.startswith("B") and name[1:].isdigit()
}


def line_speed(fd: int) -> int | None:
    """Return the output speed of the terminal's slave end [bit/s], or None if it cannot be told."""
    try:
        if sys.platform == "linux":
            raw = fcntl.ioctl(fd, _TCGETS2, bytes(_TERMIOS2.size))
            return int(_TERMIOS2.unpack(raw)[-1]) or None
        speed = termios.tcgetattr(fd)[5]
    except (OSError, termios.error):
        return None
    return _NAMED.get(speed, speed) or None
