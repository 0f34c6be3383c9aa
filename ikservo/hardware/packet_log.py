"""Record the bytes that a port sends and receives in a file, and read such files.

A program whose environment variable ``IKSERVO_PACKETS`` names a file appends to it everything that
its ports send and receive. The file is pcapng, which Wireshark opens: link type 147 (USER0), one
section per opening of a port, the direction in the flags of each packet. Source: IETF draft
draft-ietf-opsawg-pcapng.
"""

from __future__ import annotations

import contextlib
import os
import struct
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from ikservo.clock import Clock
from ikservo.errors import FileFormatError
from ikservo.files.reading import require_file
from ikservo.files.writing import FileWriteError
from ikservo.hardware.transport import Transport

_SECTION, _INTERFACE, _PACKET = 0x0A0D0D0A, 1, 6
_BYTE_ORDER_MAGIC, _LINK_USER0 = 0x1A2B3C4D, 147
_OPTION_NAME, _OPTION_RESOLUTION, _OPTION_FLAGS = 2, 9, 2
_INBOUND, _OUTBOUND = 1, 2
_FLAGS = {each: struct.pack("<HHII", _OPTION_FLAGS, 4, each, 0) for each in (_INBOUND, _OUTBOUND)}
_PACKET_HEAD = struct.Struct("<IIIII")
_MAX_BLOCK_BYTES = 1 << 20
_APPENDING = os.O_WRONLY | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0)  # Windows only


@dataclass(frozen=True, slots=True)
class LoggedBytes:
    """Bytes that a port sent or received in one call.

    Attributes:
        time_s: Seconds since the beginning of 1970; in a simulation, the time of its clock.
        sent: Whether the port sent the bytes; otherwise it received them.
        data: The bytes.
        opening: Number of the port's opening in the file, from 1.
    """

    time_s: float
    sent: bool
    data: bytes
    opening: int


def recorded_transport(transport: Transport, path: str, name: str) -> Transport:
    """Return a transport that appends its bytes to a file.

    Raises:
        FileFormatError: The file exists and is not a regular file.
        FileWriteError: The file cannot be written.
    """
    return cast("Transport", _RecordedTransport(transport, Path(path), name))


class _RecordedTransport:
    """Wrapper around a transport that writes the bytes that it sends and receives to a file.

    Each block is one write at the end of the file, so that several programs may share it and
    nothing is lost if one is killed. A full disk ends the recording; the motion continues.
    """

    def __init__(self, transport: Transport, path: Path, name: str) -> None:
        own = vars(self)
        own["_transport"], own["_path"] = transport, path
        own["_clock"] = cast("Clock | None", getattr(transport, "clock", None))
        own["_start_ns"] = time.time_ns() - time.monotonic_ns()
        try:
            if path.exists():
                require_file(path)
            own["_file"] = os.open(path, _APPENDING, 0o644)
        except OSError as error:
            raise FileWriteError(path, error.strerror or str(error), changed=False) from error
        options = _option(_OPTION_NAME, name.encode()) + _option(_OPTION_RESOLUTION, b"\x09")
        head = struct.pack("<IHHq", _BYTE_ORDER_MAGIC, 1, 0, -1)
        link = struct.pack("<HHI", _LINK_USER0, 0, 0) + options + bytes(4)
        self._append(_block(_SECTION, head) + _block(_INTERFACE, link))

    def write(self, data: bytes) -> int | None:
        self._record(_OUTBOUND, data)
        return self._transport.write(data)

    def read(self, size: int = 1) -> bytes:
        data: bytes = self._transport.read(size)
        if data:
            self._record(_INBOUND, data)
        return data

    def close(self) -> None:
        with contextlib.suppress(OSError):
            os.close(self._file)
        vars(self)["_file"] = -1
        self._transport.close()

    def _record(self, direction: int, data: bytes) -> None:
        if self._clock:
            now_ns = round(self._clock.now_s() * 1e9)
        else:
            now_ns = time.monotonic_ns() + self._start_ns
        size, flags = len(data), _FLAGS[direction]
        head = _PACKET_HEAD.pack(0, now_ns >> 32, now_ns & 0xFFFFFFFF, size, size)
        self._append(_block(_PACKET, b"".join((head, data, bytes(-size % 4), flags))))

    def _append(self, block: bytes) -> None:
        if self._file < 0:
            return
        try:
            os.write(self._file, block)
        except OSError as error:
            vars(self)["_file"] = -1
            warnings.warn(f"{self._path}: packets are no longer recorded: {error}", stacklevel=2)

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401  # any attribute of the transport
        return getattr(vars(self)["_transport"], name)

    def __setattr__(self, name: str, value: object) -> None:
        setattr(vars(self)["_transport"], name, value)


def _block(kind: int, body: bytes) -> bytes:
    length = struct.pack("<I", len(body) + 12)
    return struct.pack("<I", kind) + length + body + length


def _option(code: int, value: bytes) -> bytes:
    return struct.pack("<HH", code, len(value)) + value + bytes(-len(value) % 4)


def read_packet_log(path: Path) -> Iterator[LoggedBytes]:
    """Read the traffic of ports; an incomplete last block is left out.

    Raises:
        FileFormatError: The file is not a packet recording, or is damaged.
    """
    require_file(path)
    opening = 0
    with path.open("rb") as file:
        while head := file.read(8):
            kind, length = struct.unpack("<II", head) if len(head) == 8 else (0, 0)
            if opening == 0 and kind != _SECTION:
                raise FileFormatError(path, "", "is not a recording of packets", "a pcapng file")
            if len(head) < 8:
                return
            if length % 4 or not 12 <= length <= _MAX_BLOCK_BYTES:
                raise FileFormatError(path, f"byte {file.tell() - 8}", "is not a block of pcapng")
            body = file.read(length - 8)
            if len(body) < length - 8:
                return
            opening += kind == _SECTION
            if kind == _PACKET:
                yield _parse_packet(path, body[:-4], opening)


def _parse_packet(path: Path, body: bytes, opening: int) -> LoggedBytes:
    if len(body) < 20:
        raise FileFormatError(path, "", "has a packet that is too short")
    _, high, low, size, _ = struct.unpack_from("<IIIII", body)
    if size > len(body) - 20:
        raise FileFormatError(path, "", "has a packet that is longer than its block")
    options = body[20 + size + -size % 4 :]
    direction = 0
    if options[:4] == struct.pack("<HH", _OPTION_FLAGS, 4) and len(options) >= 8:
        direction = struct.unpack_from("<I", options, 4)[0] & 3
    time_s = ((high << 32) + low) / 1e9
    return LoggedBytes(time_s, direction == _OUTBOUND, body[20 : 20 + size], opening)
