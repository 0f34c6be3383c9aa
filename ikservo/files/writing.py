"""Write files atomically and durably, with a checksum line if needed.

The first line is ``checksum = "sha256:…"`` over everything after it, so that a file that was cut
short, mixed with another one or changed by hand is refused before any of its values is used.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import secrets
import stat
import sys
import time
from collections.abc import Callable, Generator, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any, BinaryIO

from ikservo.errors import FileFormatError, IkservoError

BACKUP_SUFFIX = ".bak"
_PROBE_BYTES = 64 * 1024  # more than a calibration and its journal
_NEW_FILE = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
_LONGEST_LOCK_S, _LOCK_POLL_S = 10.0, 0.02  # another program holds a lock for milliseconds
_UNCHANGED = "No existing file was changed"


class FileWriteError(IkservoError, OSError):
    """A file could not be written; its old content is unchanged unless an attribute says otherwise.

    Attributes:
        path: The file.
        why: The system's error text.
        changed: Whether the file was written, but its folder could not be synced.
        kept: A clause that says what was kept or written; empty if no existing file was changed.
    """

    def __init__(self, path: Path, why: str, *, changed: bool = False, kept: str = "") -> None:
        self.path, self.why, self.changed, self.kept = path, why, changed, kept
        state = "It was written, but may be lost in a power cut" if changed else kept or _UNCHANGED
        hint = f"{state}. Free disk space or correct the permissions, then try again."
        IkservoError.__init__(self, f"{path} cannot be written: {why}.", hint)


def write_atomic(
    path: Path, content: str | bytes, *, keep_old: bool = False, private: bool = False
) -> None:
    """Replace a file atomically, or leave it unchanged.

    The content is written to a temporary file in the same folder, synced, and renamed. Finally the
    folder itself is synced, because a power cut could otherwise undo the renaming.

    Args:
        path: The file; its folder is created if needed.
        content: The new content; text becomes UTF-8.
        keep_old: Whether the old content is kept in a second file, which ends in ``.bak``.
        private: Whether a new file is readable by its owner only. A replaced file keeps its
            permissions.

    Raises:
        FileWriteError: The disk is full, read-only or broken; see ``changed``.
    """
    data = content.encode("utf-8") if isinstance(content, str) else content
    with _translating_os_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        name = _write_beside(path, data, private)
        with _removed_if_it_fails(name):
            if keep_old and path.exists():
                old = _write_beside(path, path.read_bytes(), private)
                with _removed_if_it_fails(old):
                    os.replace(old, path.with_name(path.name + BACKUP_SUFFIX))  # noqa: PTH105
                _sync_folder(path.parent)
            os.replace(name, path)  # noqa: PTH105  # tests replace this call to cut the power
    with _translating_os_errors(path, changed=True):
        _sync_folder(path.parent)


def write_all_atomic(
    files: Mapping[Path, bytes | Callable[[BinaryIO], object]], *, private: bool = False
) -> None:
    """Replace files that belong together, or leave all unchanged if disk space is short.

    All contents are first written to new files in the same folders: renaming needs no space. A
    content that is a function writes itself. The files are then renamed in their order.
    Folders are created if needed; only the owner can read ``private`` new files and folders.

    Raises:
        FileWriteError: The disk is full, read-only or broken; the file is named.
    """
    made: list[Path] = []
    written: list[tuple[Path, str]] = []
    try:
        for path, data in files.items():
            with _translating_os_errors(path):
                _make_folders(path.parent, 0o700 if private else 0o777, made)
                written.append((path, _write_beside(path, data, private)))
        for path, name in written:
            with _translating_os_errors(path):
                os.replace(name, path)  # noqa: PTH105
    except BaseException:
        with contextlib.suppress(OSError):
            for _, name in written:
                Path(name).unlink(missing_ok=True)
            for folder in reversed(made):
                folder.rmdir()
        raise
    for folder in {path.parent for path in files}:
        with _translating_os_errors(folder, changed=True):
            _sync_folder(folder)


def make_folder(folder: Path) -> None:
    """Create a folder and its parents if needed.

    Raises:
        FileWriteError: The disk is full, read-only or broken.
    """
    with _translating_os_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)


def check_writable(folder: Path) -> None:
    """Check that a folder is writable, before work whose result will be stored in it.

    Raises:
        FileWriteError: The disk is full, read-only or broken.
    """
    probe = folder / ".probe"
    write_atomic(probe, " " * _PROBE_BYTES)
    remove_durably(probe)


def remove_durably(path: Path) -> None:
    """Remove a file so that it stays removed after a power cut; a missing file is not an error.

    Raises:
        FileWriteError: The file stays, or may come back after a power cut; the message says which.
    """
    with _translating_os_errors(path):
        path.unlink(missing_ok=True)
    with _translating_os_errors(path, changed=True):
        if path.parent.is_dir():
            _sync_folder(path.parent)


@contextlib.contextmanager
def exclusive_access(path: Path) -> Generator[None]:
    """Let only one program at a time read and replace a file; other programs wait.

    The lock is a second file in the same folder, because replacing the file changes its inode. The
    lock file is never removed.
    On Windows there is no lock.

    Raises:
        FileWriteError: The disk is full, read-only or broken, or another program holds the lock.
    """
    if find_spec("fcntl") is None:
        yield
        return
    import fcntl  # noqa: PLC0415  # Windows has no such module

    make_folder(path.parent)
    with _translating_os_errors(path):
        file = path.with_name(f".{path.name}.lock").open("a")
    with file:
        until_s = time.monotonic() + _LONGEST_LOCK_S
        while True:
            with _translating_os_errors(path), contextlib.suppress(BlockingIOError):
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            if time.monotonic() > until_s:
                raise FileWriteError(path, "another program is changing it")
            time.sleep(_LOCK_POLL_S)
        yield


@contextlib.contextmanager
def _translating_os_errors(path: Path, *, changed: bool = False) -> Generator[None]:
    try:
        yield
    except OSError as error:
        raise FileWriteError(path, error.strerror or str(error), changed=changed) from error


def _make_folders(folder: Path, mode: int, made: list[Path]) -> None:
    """Create a folder and its parents; append the new folders to ``made``."""
    if folder.is_dir():
        return
    _make_folders(folder.parent, mode, made)
    folder.mkdir(mode=mode)
    made.append(folder)


@contextlib.contextmanager
def _removed_if_it_fails(name: str) -> Generator[None]:
    try:
        yield
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(name)  # noqa: PTH108
        raise


def _write_beside(path: Path, data: bytes | Callable[[BinaryIO], object], private: bool) -> str:
    """Write a new file beside ``path``, with the same permissions; return its name."""
    name = str(path.with_name(f".{path.name}.{secrets.token_hex(8)}"))
    mode, is_new = 0o600 if private else 0o666, not path.exists()
    if not is_new:
        mode = stat.S_IMODE(path.stat().st_mode)
    handle = os.open(name, _NEW_FILE, mode)
    with _removed_if_it_fails(name):
        if sys.platform != "win32" and not is_new:  # also the bits that the umask removed
            with contextlib.suppress(OSError):  # FAT and network disks store no permissions
                os.fchmod(handle, mode)
        try:
            if callable(data):
                with os.fdopen(handle, "wb", closefd=False) as file:
                    data(file)
            else:
                left = memoryview(data)
                while left:
                    left = left[os.write(handle, left) :]
            os.fsync(handle)
        finally:
            os.close(handle)
    return name


def _sync_folder(folder: Path) -> None:
    if sys.platform == "win32":  # folders cannot be opened there; rename is durable enough
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


_CHECKSUM = 'checksum = "sha256:'


def checked_toml(header: str, tables: Mapping[str, Any]) -> str:
    """Format tables as TOML below a header of comments, with a checksum line in front."""
    import tomli_w  # noqa: PLC0415  # needed for writing only

    return with_checksum(header + tomli_w.dumps(tables))


def with_checksum(body: str) -> str:
    """Return a body with its checksum line in front."""
    return f"{_first_line(body)}\n{body}"


def strip_checksum(path: Path, text: str) -> str:
    """Return the body below the checksum line, if the checksum is correct.

    Raises:
        FileFormatError: There is no checksum, or it does not match the text.
    """
    first, _, body = text.replace("\r\n", "\n").partition("\n")
    if not first.startswith(_CHECKSUM):
        expected = "a file that ikservo has written"
        raise FileFormatError(path, "line 1", "is not a checksum", expected)
    if first != _first_line(body):
        expected = "the file as ikservo wrote it"
        if path.with_name(path.name + BACKUP_SUFFIX).is_file():
            expected = f"{expected}; the previous one is kept as {BACKUP_SUFFIX}"
        raise FileFormatError(
            path, "", "is damaged: its checksum does not match its content", expected
        )
    return body


def _first_line(body: str) -> str:
    return f'{_CHECKSUM}{hashlib.sha256(body.encode("utf-8", "surrogatepass")).hexdigest()}"'
