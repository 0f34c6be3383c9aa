"""The lock that lets only one program use a serial device, and names the program that has it."""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from pathlib import Path

from ikservo.errors import PortBusyError

_MAX_COMMAND_CHARS = 80  # number of characters that fit into a message
_MAX_LOCK_BYTES = 4096


class PortLock:
    """A locked file that names the process that uses a device.

    The kernel releases the lock when the process ends, however it ends; the file stays, which is
    harmless. All names of one device lead to the same file. On a system without such locks
    (Windows), a device can be opened only once anyway.
    """

    def __init__(self, descriptor: int | None = None) -> None:
        self._descriptor = descriptor

    def release(self) -> None:
        """Release the device."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def __enter__(self) -> PortLock:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()


def acquire_lock(device: str) -> PortLock:
    """Lock a device; Windows itself lets only one program at a time open a serial port.

    Raises:
        PortBusyError: Another process, or another part of this one, holds the lock; it is named.
    """
    try:
        import fcntl  # noqa: PLC0415  # not on Windows
    except ImportError:
        return PortLock()

    # The lock file of a device: the same for every link to it
    name = os.path.realpath(device).replace(os.sep, "-").strip("-")
    descriptor = _open_lock_file(Path(tempfile.gettempdir()) / f"ikservo-{name}.lock")
    if descriptor is None:
        return PortLock()  # another user's file: opening the device shows whether it is free
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        holder = os.pread(descriptor, _MAX_LOCK_BYTES, 0).decode(errors="replace").strip()
        os.close(descriptor)
        raise PortBusyError(device, holder) from None
    program, *arguments = sys.orig_argv
    command = " ".join(" ".join([Path(program).name, *arguments]).split())[:_MAX_COMMAND_CHARS]
    holder = f"{command} (process {os.getpid()})\n"
    with contextlib.suppress(OSError):  # opened for reading only
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, holder.encode(errors="replace"), 0)
    return PortLock(descriptor)


def _open_lock_file(path: Path) -> int | None:
    """Open the lock file: for writing if it belongs to this user, otherwise for reading."""
    for flags in (os.O_RDWR | os.O_CREAT, os.O_RDWR, os.O_RDONLY):
        with contextlib.suppress(OSError):
            return os.open(path, flags | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
    return None
