"""The two kinds of local address: a Unix socket, and where there is none a loopback port.

A Unix socket is guarded by the permissions of its folder and of itself. A port on the loopback
could be reached by every user of the machine, so its number lies in a file that only the owner's
user may read, together with a secret that every request has to carry.
"""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import socket
import struct
from dataclasses import dataclass
from pathlib import Path

from ikservo.arm.owner.place import make_folder

__all__ = ["HAS_UNIX", "Door", "knock", "open_door"]

HAS_UNIX = hasattr(socket, "AF_UNIX")
_LOOPBACK = "127.0.0.1"
_WAITING = 32  # connections that may queue up


@dataclass(frozen=True, slots=True)
class Door:
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
            if _made(self.place) == self.made:
                self.place.unlink()
        self.socket.close()

    def admits(self, connection: socket.socket, secret: str) -> bool:
        """Return whether whoever is on a connection is the user that listens."""
        if self.secret:
            return secrets.compare_digest(secret.encode(), self.secret.encode())
        return _user_behind(connection) in (None, os.getuid())


def open_door(place: Path) -> Door | None:
    """Listen at a place; None where another living process listens there already.

    Raises:
        OSError: The system will not have it.
        IkservoError: The folder is somebody else's.
    """
    make_folder(place.parent)
    if _alive(place):
        return None
    place.unlink(missing_ok=True)  # left behind by a process that was killed
    return _unix_door(place) if HAS_UNIX else _loopback_door(place)


def knock(place: Path, timeout_s: float) -> tuple[socket.socket, str] | None:
    """Connect to whoever listens at a place; return the socket and the secret, or None.

    Raises:
        OSError: Somebody listens and does not take the connection.
    """
    secret = ""
    try:
        if HAS_UNIX:
            connection, address = socket.socket(socket.AF_UNIX), str(place)
        else:
            port, secret = _told(place)
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


def _made(place: Path) -> tuple[int, int]:
    found = place.lstat()
    return found.st_ino, found.st_mtime_ns  # a number alone may be given again


def _alive(place: Path) -> bool:
    try:
        found = knock(place, 1.0)
    except OSError:
        return True
    if found:
        found[0].close()
    return found is not None


def _unix_door(place: Path) -> Door:
    listening = socket.socket(socket.AF_UNIX)
    try:
        listening.bind(str(place))
        place.chmod(0o600)
        listening.listen(_WAITING)
        return Door(listening, place, "", _made(place))
    except OSError:
        listening.close()
        raise


def _loopback_door(place: Path) -> Door:
    listening = socket.socket(socket.AF_INET)
    try:
        listening.bind((_LOOPBACK, 0))
        listening.listen(_WAITING)
        secret = secrets.token_hex(16)
        _tell(place, listening.getsockname()[1], secret)
        return Door(listening, place, secret, _made(place))
    except OSError:
        listening.close()
        raise


def _tell(place: Path, port: int, secret: str) -> None:
    handle = os.open(place, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        json.dump({"port": port, "secret": secret}, file)


def _told(place: Path) -> tuple[int, str]:
    """Return what the file says; a spoiled one is as good as none (ValueError)."""
    row = json.loads(place.read_text("utf-8")[:1024])
    match row:
        case {"port": int(port), "secret": str(secret)} if 0 < port < 65536:
            return port, secret
        case _:
            raise ValueError("no address")


def _user_behind(connection: socket.socket) -> int | None:
    """Return the user on the other end of a Unix socket, where the system tells (Linux)."""
    option = getattr(socket, "SO_PEERCRED", None)
    if option is None:
        return None
    credentials = struct.Struct("3i")  # process, user, group
    found = connection.getsockopt(socket.SOL_SOCKET, option, credentials.size)
    return int(credentials.unpack(found)[1])
