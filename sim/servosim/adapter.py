"""The USB adapter between a host and the line: frames, latency timer, echo."""

from __future__ import annotations

import math
from dataclasses import dataclass

from servosim.errors import SimulatorError
from servosim.inbox import Inbox

__all__ = ["Adapter", "AdapterOptions"]

PACKET_BYTES = 62  # an FTDI chip sends a packet when it is full, or when its timer runs out

LONGEST_DELAY_S = 1.0


@dataclass(frozen=True, slots=True)
class AdapterOptions:
    """How the adapter delays what it carries.

    Attributes:
        echo: Whether the host hears its own bytes: adapters without echo cancellation.
        usb_frame_s: Packets travel only at multiples of this time (1 ms at full speed); 0 = none.
        latency_s: How long an unfilled packet waits in the chip (FTDI: 16 ms unless set); 0 = none.
    """

    echo: bool = False
    usb_frame_s: float = 0.0
    latency_s: float = 0.0

    def __post_init__(self) -> None:
        for delay_s in (self.usb_frame_s, self.latency_s):
            if not 0.0 <= delay_s <= LONGEST_DELAY_S:
                raise SimulatorError(f"an adapter delays by 0 to 1000 ms, not {delay_s * 1000} ms")


@dataclass(slots=True)
class _Packet:
    """Received bytes that travel together."""

    due_s: float
    data: bytearray


class Adapter:
    """Puts bytes from the line into the host's inbox, and the host's on the line."""

    def __init__(self, inbox: Inbox, options: AdapterOptions | None = None) -> None:
        self.inbox = inbox
        self.options = options or AdapterOptions()
        self._packet: _Packet | None = None

    def departure_s(self, now_s: float) -> float:
        """Return when bytes written now leave for the line."""
        return self._next_frame_s(now_s)

    def sent(self, start_s: float, byte_s: float, data: bytes) -> None:
        """The host's bytes pass over the line."""
        if self.options.echo:
            self.received(start_s, byte_s, data)

    def received(self, start_s: float, byte_s: float, data: bytes) -> None:
        """Bytes come from the line, the first of them complete a byte time after ``start_s``."""
        options = self.options
        if not options.usb_frame_s and not options.latency_s:
            self.inbox.add(start_s, byte_s, data)
            return
        for position in range(len(data)):
            self._collect(start_s + (position + 1) * byte_s, data[position : position + 1])
        self._ship_all()

    def _collect(self, at_s: float, byte: bytes) -> None:
        packet = self._packet
        if packet is None or at_s > packet.due_s:
            self._ship_all()
            packet = self._packet = _Packet(at_s + self.options.latency_s, bytearray())
        packet.data += byte
        if len(packet.data) == PACKET_BYTES:
            packet.due_s = at_s
            self._ship_all()

    def _ship_all(self) -> None:
        if self._packet is not None:
            self.inbox.add(self._next_frame_s(self._packet.due_s), 0.0, bytes(self._packet.data))
            self._packet = None

    def _next_frame_s(self, at_s: float) -> float:
        frame_s = self.options.usb_frame_s
        return math.ceil(at_s / frame_s - 1e-9) * frame_s if frame_s else at_s
