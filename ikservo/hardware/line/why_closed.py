"""Why a port cannot be opened, in words that help."""

from __future__ import annotations

import contextlib
import errno
import sys
from pathlib import Path
from urllib.parse import urlsplit

from serial.tools import list_ports

from ikservo.errors import NoPortError, PortBusyError, PortError
from ikservo.hardware.line.holder import holder_of

__all__ = ["known_devices", "why_closed"]

_BUSY = {errno.EBUSY, errno.EAGAIN, errno.EWOULDBLOCK}
_NO_TERMINAL = {errno.EISDIR, errno.ENOTTY, errno.EINVAL, errno.ENXIO, errno.ENODEV}
_HOW = "a network port is written like socket://192.168.1.5:4000"


def why_closed(name: str, baud_rate: int, error: Exception) -> PortError:
    """Return the error that tells a person why a port did not open, and what to do.

    Args:
        name: As the person gave it.
        baud_rate: At which it was to talk.
        error: What the system or pyserial said.
    """
    code = error.errno if isinstance(error, OSError) else None
    if code in _BUSY:
        return PortBusyError(name, holder_of(name))
    if code in {errno.EACCES, errno.EPERM} or "PermissionError" in str(error):
        return PortError(f"No permission to open {name}.", _permission(name))
    if isinstance(error, OverflowError) or "baud" in str(error).lower():
        return PortError(
            f"{name} does not support {baud_rate} baud.", "Choose a rate that the adapter supports."
        )
    if "://" in name:
        return NoPortError(name, known_devices(), _reason(error) if _is_address(name) else _HOW)
    if not Path(name).exists():
        return NoPortError(name, known_devices(), "" if code == errno.ENOENT else _reason(error))
    why = "not a serial port" if _code(error) in _NO_TERMINAL else _reason(error)
    return NoPortError(name, known_devices(), why)


def _is_address(name: str) -> bool:
    """Return whether a URL is of a kind that is known, and names host and port where it must."""
    scheme = name.partition("://")[0]
    try:
        parts = urlsplit(name)
        return scheme not in {"socket", "rfc2217"} or bool(parts.hostname and parts.port)
    except ValueError:  # a port beyond 65535, or no number
        return False


def _code(error: BaseException) -> object:
    """Return the system's number of an error; pyserial drops it where it wraps one."""
    inner = error.__context__ or error
    return inner.errno if isinstance(inner, OSError) else next(iter(inner.args), None)


def _reason(error: BaseException) -> str:
    """Return why in the system's own words, without what pyserial puts around them."""
    inner = error.__context__ or error
    words = inner.strerror if isinstance(inner, OSError) else next(reversed(inner.args), None)
    return words.lower() if isinstance(words, str) else str(error)


def _permission(name: str) -> str:
    if sys.platform != "linux":
        return "Another program may use it; end that program, or plug the adapter in again."
    group = "dialout"
    with contextlib.suppress(OSError, KeyError):
        group = Path(name).group()
    return (
        f"Add yourself to its group, then log in again: sudo usermod -aG {group} $USER "
        '(or a udev rule with TAG+="uaccess").'
    )


def known_devices() -> list[str]:
    """Return the serial ports that the system knows of."""
    return sorted(port.device for port in list_ports.comports())
