"""The local socket address of an open arm: a Unix socket, or a loopback port where there is none.

A Unix socket is guarded by the permissions of its folder and of itself. A port on the loopback
could be reached by every user of the machine, so its number lies in a file that only the owner's
user may read, together with a secret that every request has to carry.
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
from dataclasses import dataclass
from pathlib import Path

from ikservo.errors import IkservoError

__all__ = [
    "HAS_UNIX_SOCKETS",
    "ListeningSocket",
    "connect",
    "make_private_directory",
    "open_socket",
    "socket_path",
    "socket_paths",
]


# What fits into an address on every system: 104 bytes on macOS, 108 on Linux.
_MAX_PATH_CHARS = 100


def socket_path(device: str) -> Path:
    """Return where the owner of a device listens; all names of one device lead to one place."""
    real = device if "://" in device else str(Path(device).resolve())
    name = hashlib.sha256(real.encode()).hexdigest()[:16]
    place = _socket_folder() / f"{name}.sock"
    return place if len(os.fsencode(place)) <= _MAX_PATH_CHARS else _shorten_path(place)


def socket_paths() -> list[Path]:
    """Return every place at which an owner of this user listens, or listened before it died."""
    near, short = _socket_folder(), _shorten_path(_socket_folder() / "x")
    prefix = short.name.removesuffix("x")
    return sorted({*near.glob("*.sock"), *short.parent.glob(f"{prefix}*.sock")})


def make_private_directory(folder: Path) -> None:
    """Make the folder, open to its user alone.

    Raises:
        IkservoError: It is somebody else's, or no folder at all.
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


def _shorten_path(place: Path) -> Path:
    """Return a place near the root for one whose path is too long for an address."""
    folder = hashlib.sha256(os.fsencode(place.parent)).hexdigest()[:16]
    return Path(tempfile.gettempdir()) / f"ikservo-{_user_id()}" / f"{folder}-{place.name}"


def _user_id() -> int:
    return os.getuid() if hasattr(os, "getuid") else 0


HAS_UNIX_SOCKETS = hasattr(socket, "AF_UNIX")
_LOOPBACK = "127.0.0.1"
_BACKLOG = 32  # connections that may queue up


@dataclass(frozen=True, slots=True)
class ListeningSocket:
    """A listening socket.

    Attributes:
        socket: What is listened on.
        place: The socket's file, or the file that tells of the port.
        secret: What a request has to carry; empty where permissions guard the socket.
        made: Which file it is and when it was made, so that nobody else's is ever removed.
    """

    socket: socket.socket
    place: Path
    secret: str
    made: tuple[int, int]

    def close(self) -> None:
        """Stop listening and take the file away."""
        with contextlib.suppress(OSError):
            if _file_identity(self.place) == self.made:
                self.place.unlink()
        self.socket.close()

    def authenticate(self, connection: socket.socket, secret: str) -> bool:
        """Return whether whoever is on a connection is the user that listens."""
        if self.secret:
            return secrets.compare_digest(secret.encode(), self.secret.encode())
        return _peer_user(connection) in (None, os.getuid())


def open_socket(place: Path) -> ListeningSocket | None:
    """Listen at a place; None where another living process listens there already.

    Raises:
        OSError: The system will not have it.
        IkservoError: The folder is somebody else's.
    """
    make_private_directory(place.parent)
    if _is_listening(place):
        return None
    place.unlink(missing_ok=True)  # left behind by a process that was killed
    return _listen_unix(place) if HAS_UNIX_SOCKETS else _listen_loopback(place)


def connect(place: Path, timeout_s: float) -> tuple[socket.socket, str] | None:
    """Connect to whoever listens at a place; return the socket and the secret, or None.

    Raises:
        OSError: Somebody listens and does not take the connection.
    """
    secret = ""
    try:
        if HAS_UNIX_SOCKETS:
            connection, address = socket.socket(socket.AF_UNIX), str(place)
        else:
            port, secret = _read_address_file(place)
            connection, address = socket.socket(socket.AF_INET), (_LOOPBACK, port)
    except (FileNotFoundError, ValueError):
        return None
    connection.settimeout(timeout_s)
    try:
        connection.connect(address)
    except (FileNotFoundError, ConnectionRefusedError):
        connection.close()
        return None
    except OSError:
        connection.close()
        raise
    return connection, secret


def _file_identity(place: Path) -> tuple[int, int]:
    found = place.lstat()
    return found.st_ino, found.st_mtime_ns  # a number alone may be given again


def _is_listening(place: Path) -> bool:
    try:
        found = connect(place, 1.0)
    except OSError:
        return True
    if found:
        found[0].close()
    return found is not None


def _listen_unix(place: Path) -> ListeningSocket:
    listening = socket.socket(socket.AF_UNIX)
    try:
        listening.bind(str(place))
        place.chmod(0o600)
        listening.listen(_BACKLOG)
        return ListeningSocket(listening, place, "", _file_identity(place))
    except OSError:
        listening.close()
        raise


def _listen_loopback(place: Path) -> ListeningSocket:
    listening = socket.socket(socket.AF_INET)
    try:
        listening.bind((_LOOPBACK, 0))
        listening.listen(_BACKLOG)
        secret = secrets.token_hex(16)
        _write_address_file(place, listening.getsockname()[1], secret)
        return ListeningSocket(listening, place, secret, _file_identity(place))
    except OSError:
        listening.close()
        raise


def _write_address_file(place: Path, port: int, secret: str) -> None:
    handle = os.open(place, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        json.dump({"port": port, "secret": secret}, file)


def _read_address_file(place: Path) -> tuple[int, str]:
    """Return what the file says; a spoiled one is as good as none (ValueError)."""
    row = json.loads(place.read_text("utf-8")[:1024])
    match row:
        case {"port": int(port), "secret": str(secret)} if 0 < port < 65536:
            return port, secret
        case _:
            raise ValueError("no address")


def _peer_user(connection: socket.socket) -> int | None:
    """Return the user on the other end of a Unix socket, where the system tells (Linux)."""
    option = getattr(socket, "SO_PEERCRED", None)
    if option is None:
        return None
    credentials = struct.Struct("3i")  # process, user, group
    found = connection.getsockopt(socket.SOL_SOCKET, option, credentials.size)
    return int(credentials.unpack(found)[1])
