"""One process to a port: a lock that names its holder and dies with it."""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from pathlib import Path
from types import TracebackType

from ikservo.errors import PortBusyError

__all__ = ["PortLock", "lock_of"]

_MOST_COMMAND = 80  # characters that fit into a message
_MOST_BYTES = 4096


class PortLock:
    """A locked file that says who holds a device.

    The kernel releases the lock when the process ends, however it ends; the file stays and does
    no harm. All names of one device lead to one file. Where the system has no such locks
    (Windows) the device itself can be opened only once anyway.
    """

    def __init__(self, descriptor: int | None = None) -> None:
        self._descriptor = descriptor

    def release(self) -> None:
        """Let others have the device."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def __enter__(self) -> PortLock:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.release()


def lock_of(device: str) -> PortLock:
    """Take the lock of a device.

    Raises:
        PortBusyError: Another process, or another part of this one, has it; it is named.
    """
    if sys.platform == "win32":
        return PortLock()
    import fcntl  # noqa: PLC0415  # there is none on Windows

    descriptor = _opened(_path(device))
    if descriptor is None:
        return PortLock()  # another user's file that we may not even read: the device will tell
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        holder = os.pread(descriptor, _MOST_BYTES, 0).decode(errors="replace").strip()
        os.close(descriptor)
        raise PortBusyError(device, holder) from None
    _sign(descriptor)
    return PortLock(descriptor)


def _path(device: str) -> Path:
    """Return the lock file of a device: the same for every link to it."""
    name = str(Path(device).resolve()).replace(os.sep, "-").strip("-")
    return Path(tempfile.gettempdir()) / f"ikservo-{name}.lock"


def _opened(path: Path) -> int | None:
    """Open the lock file, for writing where it is ours, for reading where it is another's."""
    for flags in (os.O_RDWR | os.O_CREAT, os.O_RDWR, os.O_RDONLY):
        with contextlib.suppress(OSError):
            return os.open(path, flags | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
    return None


def _sign(descriptor: int) -> None:
    """Write who we are into the file we hold."""
    program, *words = sys.orig_argv
    command = " ".join(" ".join([Path(program).name, *words]).split())[:_MOST_COMMAND]
    with contextlib.suppress(OSError):  # opened for reading only
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, f"{command} (process {os.getpid()})\n".encode(), 0)
