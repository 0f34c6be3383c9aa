"""Bytes on their way to the host: each has a moment at which it has arrived."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

__all__ = ["Inbox"]


@dataclass(slots=True)
class _Chunk:
    start_s: float
    byte_s: float
    data: bytes

    def arrived(self, now_s: float) -> int:
        """How many of the bytes have arrived by now."""
        if self.byte_s <= 0.0:
            return len(self.data) if now_s >= self.start_s else 0
        # A nanosecond of grace: sums of byte times are not exact.
        whole = int((now_s - self.start_s) / self.byte_s + 1e-6)
        return max(0, min(len(self.data), whole))

    def time_of(self, count: int) -> float:
        """When the first ``count`` bytes have arrived."""
        return self.start_s + count * self.byte_s


class Inbox:
    """A receive buffer that fills by itself as time passes."""

    def __init__(self) -> None:
        self._chunks: deque[_Chunk] = deque()

    def add(self, start_s: float, byte_s: float, data: bytes) -> None:
        """Let ``data`` arrive from ``start_s`` on, one byte each ``byte_s``; in order of time."""
        if data:
            self._chunks.append(_Chunk(start_s, byte_s, data))

    def waiting(self, now_s: float) -> int:
        """Return how many bytes have arrived and are not taken."""
        return sum(chunk.arrived(now_s) for chunk in self._chunks)

    def take(self, limit: int, now_s: float) -> bytes:
        """Take at most ``limit`` of the bytes that have arrived."""
        taken = bytearray()
        while self._chunks and len(taken) < limit:
            chunk = self._chunks[0]
            count = min(limit - len(taken), chunk.arrived(now_s))
            taken += chunk.data[:count]
            if count < len(chunk.data):
                self._chunks[0] = _Chunk(chunk.time_of(count), chunk.byte_s, chunk.data[count:])
                break
            self._chunks.popleft()
        return bytes(taken)

    def time_of(self, count: int) -> float | None:
        """Return when ``count`` bytes will be there, or None if so many are not on their way."""
        for chunk in self._chunks:
            if count <= len(chunk.data):
                return chunk.time_of(count)
            count -= len(chunk.data)
        return None

    def last_s(self) -> float | None:
        """Return when everything on its way has arrived, or None when nothing is."""
        if not self._chunks:
            return None
        last = self._chunks[-1]
        return last.time_of(len(last.data))

    def clear(self, now_s: float) -> None:
        """Throw away what has arrived; what is still on the wire comes."""
        self.take(self.waiting(now_s), now_s)

    def end_of_first_s(self) -> float | None:
        """Return when the first burst on its way has arrived, or None when nothing is."""
        if not self._chunks:
            return None
        first = self._chunks[0]
        return first.time_of(len(first.data))
