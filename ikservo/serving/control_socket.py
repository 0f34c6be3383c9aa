"""The local socket address of an open arm: a Unix socket, or else a loopback port.

A Unix socket is guarded by its own permissions and those of its folder. A port on the loopback
could be reached by every user of the machine, so its number is in a file that only this user may
read, together with a secret that every request must contain.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import secrets
import socket
import stat
import struct
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from ikservo.errors import IkservoError

# Length of an address that fits on every system: 104 bytes on macOS, 108 on Linux.
_MAX_PATH_CHARS = 100


def socket_path(device: str, arm: str = "") -> Path:
    """Return the socket path of a device; it is the same for all names of the device.

    ``arm`` is given if another arm on this device listens at the path without a name.
    """
    real = device if "://" in device else os.path.realpath(device)
    real += f"#{arm}" if arm else ""
    name = hashlib.sha256(os.fsencode(real)).hexdigest()[:16]
    path = _socket_folder() / f"{name}.sock"
    return path if len(os.fsencode(path)) <= _MAX_PATH_CHARS else _shorten_path(path)


def socket_paths() -> list[Path]:
    """Return every path at which a process of this user listens, or listened before it ended."""
    near, short = _socket_folder(), _shorten_path(_socket_folder() / "x")
    prefix = short.name.removesuffix("x")
    return sorted({*near.glob("*.sock"), *short.parent.glob(f"{prefix}*.sock")})


def make_private_directory(folder: Path) -> None:
    """Create the folder so that only this user can access it.

    Raises:
        IkservoError: The folder belongs to another user, or is not a folder.
    """
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != _user_id():
        raise IkservoError(f"{folder} is not a folder of this user.", "Remove it.")
    if stat.S_IMODE(found.st_mode) != 0o700:
        folder.chmod(0o700)


def _socket_folder() -> Path:
    own = os.environ.get("IKSERVO_HOME")
    if own:
        return Path(own).resolve() / "run"
    session = os.environ.get("XDG_RUNTIME_DIR")
    if session:
        return Path(session) / "ikservo"
    return Path(tempfile.gettempdir()) / f"ikservo-run-{_user_id()}"


def _shorten_path(path: Path) -> Path:
    """Find a short path that replaces a path that is too long for an address."""
    folder = hashlib.sha256(os.fsencode(path.parent)).hexdigest()[:16]
    return Path(tempfile.gettempdir()) / f"ikservo-{_user_id()}" / f"{folder}-{path.name}"


def _user_id() -> int:
    return os.getuid() if hasattr(os, "getuid") else 0


HAS_UNIX_SOCKETS = hasattr(socket, "AF_UNIX")
_LOOPBACK = "127.0.0.1"
_BACKLOG = 32  # connections that may queue up


@dataclass(frozen=True, slots=True)
class ListeningSocket:
    """A listening socket.

    Attributes:
        socket: The socket.
        path: The socket's file, or the file with the port number.
        secret: Part of every request; empty if permissions guard the socket.
        identity: Inode and time of the file, so that the file of another process is never removed.
    """

    socket: socket.socket
    path: Path
    secret: str
    identity: tuple[int, int]

    def close(self) -> None:
        """Stop listening and remove the file."""
        with contextlib.suppress(OSError):
            if _file_identity(self.path) == self.identity:
                self.path.unlink()
        self.socket.close()

    def authenticate(self, connection: socket.socket, secret: str) -> bool:
        """Check whether the client of a connection is this user."""
        if self.secret:
            return secrets.compare_digest(secret.encode(), self.secret.encode())
        return _peer_user(connection) in (None, os.getuid())


def open_socket(path: Path) -> ListeningSocket | None:
    """Listen at a path; return None if another process already listens there.

    Raises:
        OSError: The socket cannot be created.
        IkservoError: The folder belongs to another user.
    """
    make_private_directory(path.parent)
    try:
        found = connect(path, 1.0)
    except OSError:  # a process listens, but accepts no connection
        return None
    if found:
        found[0].close()
        return None
    path.unlink(missing_ok=True)  # left by a killed process
    listening, secret = socket.socket(socket.AF_UNIX if HAS_UNIX_SOCKETS else socket.AF_INET), ""
    try:
        if HAS_UNIX_SOCKETS:
            listening.bind(str(path))
            path.chmod(0o600)
            listening.listen(_BACKLOG)
        else:
            listening.bind((_LOOPBACK, 0))
            listening.listen(_BACKLOG)
            secret = secrets.token_hex(16)
            handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                json.dump({"port": listening.getsockname()[1], "secret": secret}, file)
        return ListeningSocket(listening, path, secret, _file_identity(path))
    except OSError:
        listening.close()
        raise


def connect(path: Path, timeout_s: float) -> tuple[socket.socket, str] | None:
    """Connect to the process that listens at a path; return socket and secret, or None.

    Raises:
        OSError: A process listens and does not accept the connection.
    """
    secret = ""
    try:
        if HAS_UNIX_SOCKETS:
            connection, address = socket.socket(socket.AF_UNIX), str(path)
        else:
            port, secret = _read_address_file(path)
            connection, address = socket.socket(socket.AF_INET), (_LOOPBACK, port)
    except (FileNotFoundError, ValueError):
        return None
    connection.settimeout(timeout_s)
    ends_s = time.monotonic() + timeout_s
    while True:
        try:
            connection.connect(address)
            return connection, secret
        except (FileNotFoundError, ConnectionRefusedError):
            connection.close()
            return None
        except OSError as error:
            # A Unix socket at which too many clients wait refuses the next client immediately.
            if not isinstance(error, BlockingIOError) or time.monotonic() > ends_s:
                connection.close()
                raise
        time.sleep(0.01)


def _file_identity(path: Path) -> tuple[int, int]:
    found = path.lstat()
    return found.st_ino, found.st_mtime_ns  # an inode number alone may be reused


def _read_address_file(path: Path) -> tuple[int, str]:
    """Read port and secret from the file; a malformed file raises ValueError."""
    row = json.loads(path.read_text("utf-8")[:1024])
    match row:
        case {"port": int(port), "secret": str(secret)} if 0 < port < 65536:
            return port, secret
        case _:
            raise ValueError("no address")


def _peer_user(connection: socket.socket) -> int | None:
    """Return the user on the other end of a Unix socket, if the system reports it (Linux)."""
    option = getattr(socket, "SO_PEERCRED", None)
    if option is None:
        return None
    credentials = struct.Struct("3i")  # process, user, group
    found = connection.getsockopt(socket.SOL_SOCKET, option, credentials.size)
    return int(credentials.unpack(found)[1])
