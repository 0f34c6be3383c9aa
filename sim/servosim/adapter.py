"""The USB adapter between host and line: frames, latency timer, echo, receive buffer."""

from __future__ import annotations

import math
from dataclasses import dataclass

from servosim.errors import SimulatorError

GRACE = 1e-6  # tolerance in bytes, because sums of byte times are not exact


@dataclass(slots=True)
class _ByteBurst:
    start_s: float
    byte_s: float
    data: bytes

    def arrived_count(self, now_s: float) -> int:
        """Count the bytes that have arrived by a time."""
        if self.byte_s <= 0.0:
            return len(self.data) if now_s >= self.start_s else 0
        whole, size = int((now_s - self.start_s) / self.byte_s + GRACE), len(self.data)
        if whole >= size:
            return size
        return whole if whole > 0 else 0

    def arrival_time_s(self, count: int) -> float:
        """Compute the time at which the first ``count`` bytes have arrived."""
        return self.start_s + count * self.byte_s


class ReceiveBuffer:
    """A receive buffer that fills by itself as time passes."""

    def __init__(self) -> None:
        self._bursts: list[_ByteBurst] = []

    def add(self, start_s: float, byte_s: float, data: bytes) -> None:
        """Schedule ``data`` to arrive from ``start_s`` on, one byte per ``byte_s`` seconds."""
        if data:
            place = len(self._bursts)
            while place and self._bursts[place - 1].start_s > start_s:
                place -= 1
            self._bursts.insert(place, _ByteBurst(start_s, byte_s, data))

    def count_arrived(self, now_s: float) -> int:
        """Count the bytes that have arrived and were not taken."""
        count = 0
        for burst in self._bursts:
            if burst.start_s > now_s:
                break
            count += burst.arrived_count(now_s)
        return count

    def take(self, limit: int, now_s: float) -> bytes:
        """Take at most ``limit`` of the bytes that have arrived."""
        taken = bytearray()
        done = 0
        for burst in self._bursts:
            count = min(limit - len(taken), burst.arrived_count(now_s))
            taken += burst.data[:count]
            if count < len(burst.data):
                burst.start_s, burst.data = burst.arrival_time_s(count), burst.data[count:]
                break
            done += 1
        del self._bursts[:done]
        return bytes(taken)

    def arrival_time_s(self, count: int) -> float | None:
        """Return when ``count`` bytes will have arrived, or None if fewer are pending."""
        for burst in self._bursts:
            if count <= len(burst.data):
                return burst.arrival_time_s(count)
            count -= len(burst.data)
        return None

    def next_end_s(self) -> float | None:
        """Return when the first burst will have arrived, or None if none is pending."""
        if not self._bursts:
            return None
        first = self._bursts[0]
        return first.arrival_time_s(len(first.data))

    def last_s(self) -> float | None:
        """Return when all pending bytes will have arrived, or None if none are pending."""
        if not self._bursts:
            return None
        last = self._bursts[-1]
        return last.arrival_time_s(len(last.data))

    def clear(self, now_s: float) -> None:
        """Discard received bytes; those still on the wire arrive later."""
        self.take(self.count_arrived(now_s), now_s)


PACKET_BYTES = 62  # an FTDI chip sends a packet when it is full, or when its timer runs out

MAX_DELAY_S = 1.0


@dataclass(frozen=True, slots=True)
class AdapterOptions:
    """Delays of the adapter.

    Attributes:
        echo: Whether the host receives its own bytes, as with adapters without echo cancellation.
        usb_frame_s: Packets travel only at multiples of this time (1 ms at full speed); 0 = none.
        latency_s: Time for which an unfilled packet waits in the chip (FTDI: 16 ms unless set); 0 =
            none.
    """

    echo: bool = False
    usb_frame_s: float = 0.0
    latency_s: float = 0.0

    def __post_init__(self) -> None:
        for delay_s in (self.usb_frame_s, self.latency_s):
            if not 0.0 <= delay_s <= MAX_DELAY_S:
                delay_ms = 1000 * delay_s
                raise SimulatorError(f"the delay of an adapter is 0 to 1000 ms, not {delay_ms} ms")


@dataclass(slots=True)
class _Packet:
    """Received bytes that travel together."""

    due_s: float
    data: bytearray


class UsbAdapter:
    """Moves bytes from the line into the host's inbox, and the host's bytes onto the line."""

    def __init__(self, inbox: ReceiveBuffer, options: AdapterOptions | None = None) -> None:
        self.inbox = inbox
        self.options = options or AdapterOptions()
        self._packet: _Packet | None = None

    def departure_s(self, now_s: float) -> float:
        """Return when bytes written now leave for the line."""
        return self._next_frame_s(now_s)

    def send_to_line(self, start_s: float, byte_s: float, data: bytes) -> None:
        """Put the host's bytes on the line."""
        if self.options.echo:
            self.receive_from_line(start_s, byte_s, data)

    def receive_from_line(self, start_s: float, byte_s: float, data: bytes) -> None:
        """Take bytes from the line, the first of them complete a byte time after ``start_s``."""
        options = self.options
        if not options.usb_frame_s and not options.latency_s:
            self.inbox.add(start_s, byte_s, data)
            return
        for position in range(len(data)):
            self._collect_byte(start_s + (position + 1) * byte_s, data[position : position + 1])
        self._flush_packets()

    def _collect_byte(self, at_s: float, byte: bytes) -> None:
        packet = self._packet
        if packet is None or at_s > packet.due_s:
            self._flush_packets()
            packet = self._packet = _Packet(at_s + self.options.latency_s, bytearray())
        packet.data += byte
        if len(packet.data) == PACKET_BYTES:
            packet.due_s = at_s
            self._flush_packets()

    def _flush_packets(self) -> None:
        if self._packet is not None:
            self.inbox.add(self._next_frame_s(self._packet.due_s), 0.0, bytes(self._packet.data))
            self._packet = None

    def _next_frame_s(self, at_s: float) -> float:
        frame_s = self.options.usb_frame_s
        return math.ceil(at_s / frame_s - 1e-9) * frame_s if frame_s else at_s
