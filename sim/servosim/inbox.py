"""Bytes on their way to the host: each has a moment at which it has arrived."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Inbox"]

GRACE = 1e-6  # of a byte: sums of byte times are not exact


@dataclass(slots=True)
class _Burst:
    start_s: float
    byte_s: float
    data: bytes

    def arrived(self, now_s: float) -> int:
        """How many of the bytes have arrived by now."""
        if self.byte_s <= 0.0:
            return len(self.data) if now_s >= self.start_s else 0
        whole = int((now_s - self.start_s) / self.byte_s + GRACE)
        return max(0, min(len(self.data), whole))

    def time_of(self, count: int) -> float:
        """When the first ``count`` bytes have arrived."""
        return self.start_s + count * self.byte_s


class Inbox:
    """A receive buffer that fills by itself as time passes."""

    def __init__(self) -> None:
        self._bursts: list[_Burst] = []

    def add(self, start_s: float, byte_s: float, data: bytes) -> None:
        """Let ``data`` arrive from ``start_s`` on, one byte each ``byte_s``."""
        if data:
            place = len(self._bursts)
            while place and self._bursts[place - 1].start_s > start_s:
                place -= 1
            self._bursts.insert(place, _Burst(start_s, byte_s, data))

    def waiting(self, now_s: float) -> int:
        """Return how many bytes have arrived and are not taken."""
        count = 0
        for burst in self._bursts:
            if burst.start_s > now_s:
                break
            count += burst.arrived(now_s)
        return count

    def take(self, limit: int, now_s: float) -> bytes:
        """Take at most ``limit`` of the bytes that have arrived."""
        taken = bytearray()
        done = 0
        for burst in self._bursts:
            count = min(limit - len(taken), burst.arrived(now_s))
            taken += burst.data[:count]
            if count < len(burst.data):
                burst.start_s, burst.data = burst.time_of(count), burst.data[count:]
                break
            done += 1
        del self._bursts[:done]
        return bytes(taken)

    def time_of(self, count: int) -> float | None:
        """Return when ``count`` bytes will be there, or None if so many are not on their way."""
        for burst in self._bursts:
            if count <= len(burst.data):
                return burst.time_of(count)
            count -= len(burst.data)
        return None

    def next_end_s(self) -> float | None:
        """Return when the first burst will have arrived, or None when nothing is on its way."""
        if not self._bursts:
            return None
        first = self._bursts[0]
        return first.time_of(len(first.data))

    def last_s(self) -> float | None:
        """Return when everything on its way will have arrived, or None when nothing is."""
        if not self._bursts:
            return None
        last = self._bursts[-1]
        return last.time_of(len(last.data))

    def clear(self, now_s: float) -> None:
        """Throw away what has arrived; what is still on the wire comes."""
        self.take(self.waiting(now_s), now_s)
