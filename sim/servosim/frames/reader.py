"""The search for frames in a stream of bytes, the same for both framings."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

__all__ = ["Frame", "FrameReader"]


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame with a good checksum.

    Attributes:
        id: The addressed servo, or the servo that answers.
        instruction: The instruction byte; in a protocol 1 status, the error byte.
        params: What follows the instruction, stuffing removed, without the checksum.
        end: Bytes of the feed that completed the frame, counted from that feed's start.
        raw: The frame as it came.
    """

    id: int
    instruction: int
    params: bytes = b""
    end: int = 0
    raw: bytes = field(default=b"", compare=False, repr=False)


class FrameReader:
    """Finds frames in whatever arrives; junk and bad checksums are counted and skipped."""

    header: ClassVar[bytes]
    shortest: ClassVar[int]  # bytes that must be there before the length is known

    def __init__(self) -> None:
        self.junk_bytes = 0
        self.bad_checksums = 0
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Frame]:
        """Take bytes in; return the frames they complete, in order."""
        before = len(self._buffer)
        self._buffer += data
        frames: list[Frame] = []
        at = 0
        while (start := self._find_header(at)) is not None:
            size = self._size(start)
            if size is None or start + size > len(self._buffer):
                self._forget(at, start)
                return frames
            at = self._take(at, start, size, before, frames)
        return frames

    def reset(self) -> None:
        """Forget a frame that never came to its end."""
        self.junk_bytes += len(self._buffer)
        self._buffer.clear()

    def _find_header(self, at: int) -> int | None:
        start = self._buffer.find(self.header, at)
        if start >= 0:
            return start
        keep = min(len(self.header) - 1, len(self._buffer) - at)
        while not self.header.startswith(self._buffer[len(self._buffer) - keep :]):
            keep -= 1
        self._forget(at, len(self._buffer) - keep)
        return None

    def _forget(self, at: int, start: int) -> None:
        self.junk_bytes += start - at
        del self._buffer[:start]

    def _take(self, at: int, start: int, size: int, before: int, frames: list[Frame]) -> int:
        """Append the frame at ``start`` if it is one; return where the search goes on."""
        self.junk_bytes += start - at
        if size > 0:
            frame = self._parse(bytes(self._buffer[start : start + size]), start + size - before)
            if frame is not None:
                frames.append(frame)
                return start + size
            self.bad_checksums += 1
        self.junk_bytes += 1
        return start + 1

    def _size(self, start: int) -> int | None:
        """Return the whole frame's size, 0 for a false header, None when it is not known yet."""
        raise NotImplementedError

    def _parse(self, raw: bytes, end: int) -> Frame | None:
        """Return the frame, or None when its checksum is bad."""
        raise NotImplementedError
