"""The half-duplex line: transmission times, replies, collisions."""

from __future__ import annotations

import heapq
import itertools
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from servosim import instructions_1 as dynamixel1
from servosim import instructions_2 as dynamixel2
from servosim.adapter import AdapterOptions, ReceiveBuffer, UsbAdapter
from servosim.errors import SimulatorError
from servosim.faults import FaultScript
from servosim.frames import Frame, FrameReader
from servosim.instructions_1 import Reply, ReplySlot
from servosim.servo import BusProtocol, Servo
from servosim.traffic import FrameListener
from servosim.world import World

ANSWERS: dict[BusProtocol, Callable[[Frame, Sequence[Servo]], list[ReplySlot]]] = {
    BusProtocol.DYNAMIXEL_2: dynamixel2.answer,
    BusProtocol.DYNAMIXEL_1: dynamixel1.respond,
    BusProtocol.FEETECH: dynamixel1.respond,
}

SAMPLES = 8  # samples per bit
FRAME_BITS = 10  # start bit, eight data bits, stop bit


def resolve_collision(
    speeches: Sequence[tuple[float, bytes]], byte_s: float
) -> tuple[float, bytes]:
    """Return the bytes that a UART reads from overlapping bytes on a line where low dominates.

    Args:
        speeches: Start [s] and bytes of each transmission.
        byte_s: Time of one byte [s]; zero if the wire takes no time.

    Returns:
        The start of the first transmission and the bytes that a UART reads.
    """
    start_s = min(at_s for at_s, _ in speeches)
    if byte_s <= 0.0:
        return start_s, _overlay_signals([data for _, data in speeches])
    sample_s = byte_s / (FRAME_BITS * SAMPLES)
    shifted = [(round((at_s - start_s) / sample_s), data) for at_s, data in speeches]
    return start_s, _decode_levels(_line_levels(shifted))


def _overlay_signals(speeches: Sequence[bytes]) -> bytes:
    length = max(map(len, speeches))
    padded = [data.ljust(length, b"\xff") for data in speeches]
    mixed = bytearray(padded[0])
    for data in padded[1:]:
        mixed = bytearray(a & b for a, b in zip(mixed, data, strict=True))
    return bytes(mixed)


def _line_levels(shifted: Sequence[tuple[int, bytes]]) -> list[bool]:
    end = max(at + len(data) * FRAME_BITS * SAMPLES for at, data in shifted)
    levels = [True] * (end + FRAME_BITS * SAMPLES)
    for start, data in shifted:
        for position, byte in enumerate(data):
            bits = byte << 1 | 1 << 9  # start bit low, least significant first, stop bit high
            for k in range(FRAME_BITS):
                if not bits >> k & 1:
                    at = start + (position * FRAME_BITS + k) * SAMPLES
                    levels[at : at + SAMPLES] = [False] * SAMPLES
    return levels


def _decode_levels(levels: Sequence[bool]) -> bytes:
    received = bytearray()
    at, middle = 0, SAMPLES // 2
    last = len(levels) - FRAME_BITS * SAMPLES
    while at < last:
        if levels[at]:
            at += 1
            continue
        bits = [levels[at + middle + k * SAMPLES] for k in range(FRAME_BITS)]
        received.append(sum(bit << k for k, bit in enumerate(bits[1:9])))
        at += (FRAME_BITS - 1) * SAMPLES + middle
    return bytes(received)


BITS_PER_BYTE = 10
PING_PACKET = 14  # bytes of the longest ping status, which is a slot of the broadcast ping
PING_PAUSE_S = 0.0005  # assumed pause between two slots
FRAME_TIMEOUT_S = 0.0005  # assumed extra wait of the next servo in a sync read
ROUNDING_S = 1e-9
CRYSTAL_S = 4e-6  # assumed spread of a servo's reaction time


@dataclass(frozen=True, slots=True)
class LineOptions:
    """Behaviour of the line.

    Attributes:
        wire_time: Whether the transmission of bytes takes time.
        gap_s: A pause between bytes after which a servo drops an unfinished frame.
        noise: Probability that a byte has one bit flipped.
        seed: The seed of all random events on the line.
        adapter: The host's adapter.
    """

    wire_time: bool = True
    gap_s: float = 0.0015
    noise: float = 0.0
    seed: int = 0
    adapter: AdapterOptions = field(default_factory=AdapterOptions)

    def __post_init__(self) -> None:
        if not 0.0 <= self.noise <= 1.0:
            raise SimulatorError(f"noise is a probability from 0 to 1, not {self.noise}")


@dataclass(slots=True)
class _BusTransmission:
    """Bytes transmitted on the line."""

    start_s: float
    byte_s: float
    data: bytes
    servo: Servo | None = None
    garbled: bool = False
    end_s: float = field(init=False)

    def __post_init__(self) -> None:
        self.end_s = self.start_s + len(self.data) * self.byte_s


@dataclass(slots=True)
class _Delivery:
    """A frame that servos will have received completely at ``at_s``."""

    at_s: float
    framing: type[FrameReader]
    baud: int
    frame: Frame
    speech: _BusTransmission


class Line:
    """The wire between a host's adapter and its servos, in the caller's time.

    The owner of a clock calls ``host_write`` when the host writes and ``run_until`` when time has
    passed; replies collect in ``inbox`` with their arrival times, and ``host_end_s`` is when the
    host's last byte will have left.

    Attributes:
        world: The servos and what they move.
        baud: The host's rate.
        inbox: Bytes that will arrive at the host.
        faults: The injected faults.
        witnesses: Listeners to every frame.
        plugged: Whether the adapter's cable is plugged in.
    """

    def __init__(self, world: World, baud: int, options: LineOptions | None = None) -> None:
        self.world, self.baud = world, baud
        self.options = options or LineOptions()
        self.inbox = ReceiveBuffer()
        self.adapter = UsbAdapter(self.inbox, self.options.adapter)
        self.random = random.Random(self.options.seed)  # noqa: S311 - chance on a wire
        self.faults = FaultScript(self, self.options.seed)
        self.witnesses: list[FrameListener] = []
        self.plugged = True
        self.readers: dict[type[FrameReader], FrameReader] = {}
        self.host_end_s = 0.0
        self._due: list[tuple[float, int, _Delivery]] = []
        self._order = itertools.count()
        self._hosts: list[_BusTransmission] = []
        self._replies: list[_BusTransmission] = []

    @property
    def servos(self) -> dict[int, Servo]:
        """The servos by id; if two have the same id, the first."""
        found: dict[int, Servo] = {}
        for servo in self.world.servos:
            found.setdefault(servo.id, servo)
        return found

    @property
    def byte_s(self) -> float:
        """Time of one byte at the host's baud rate [s]."""
        return BITS_PER_BYTE / self.baud if self.options.wire_time else 0.0

    @property
    def all_received_s(self) -> float:
        """Time at which all bytes written by the host will have been received."""
        return max((at_s for at_s, _, _ in self._due), default=self.host_end_s)

    @property
    def replies_end_s(self) -> float:
        """Time at which the last byte of all replies so far has passed over the line."""
        return max((reply.end_s for reply in self._replies), default=0.0)

    @property
    def next_event_s(self) -> float | None:
        """Time at which the next frame will have been received, or None if the line is idle."""
        return self._due[0][0] if self._due else None

    def set_baud(self, baud: int) -> None:
        """Set the host's rate; servos at another rate receive noise instead of frames."""
        if baud != self.baud:
            self.baud = baud
            self._reset_partial_frames()

    def host_write(self, data: bytes, now_s: float) -> float:
        """Put bytes on the line after those already there; return when the last byte has left."""
        self.run_until(now_s)
        start_s = max(self.adapter.departure_s(now_s), self.host_end_s)
        if start_s - self.host_end_s > self.options.gap_s:
            self._reset_partial_frames()
        speech = _BusTransmission(start_s, self.byte_s, self._add_noise(data))
        self.host_end_s = speech.end_s
        speech.garbled = any(_is_overlapping(reply, speech) for reply in self._replies)
        self._hosts = [s for s in self._hosts if s.end_s > now_s]
        self._hosts.append(speech)
        self.adapter.send_to_line(start_s, speech.byte_s, speech.data)
        for framing in {servo.framing for servo in self.world.servos}:
            self._deliver_to_servos(framing, speech)
        return speech.end_s

    def run_until(self, now_s: float) -> None:
        """Advance time: servos move, receive complete frames, and reply."""
        while self._due and self._due[0][0] <= now_s:
            delivery = heapq.heappop(self._due)[2]
            self.world.advance_to(delivery.at_s)
            if not delivery.speech.garbled and not self.faults.loses_instruction(delivery.at_s):
                self._process_delivery(delivery)
        self.world.advance_to(now_s)

    def _deliver_to_servos(self, framing: type[FrameReader], speech: _BusTransmission) -> None:
        reader = self.readers.get(framing)
        if reader is None:
            reader = self.readers[framing] = framing()
        for frame in reader.feed(speech.data):
            at_s = speech.start_s + frame.end * speech.byte_s
            delivery = _Delivery(at_s, framing, self.baud, frame, speech)
            heapq.heappush(self._due, (at_s, next(self._order), delivery))

    def _process_delivery(self, delivery: _Delivery) -> None:
        groups: dict[BusProtocol, list[Servo]] = {}
        for servo in self.world.servos:
            if servo.framing is delivery.framing and servo.is_listening(
                delivery.baud, delivery.at_s
            ):
                groups.setdefault(servo.protocol, []).append(servo)
        for witness in self.witnesses:
            witness.on_frame(delivery.at_s, delivery.frame, delivery.framing)
        for protocol, servos in groups.items():
            self._schedule_replies(ANSWERS[protocol](delivery.frame, servos), delivery)

    def _schedule_replies(self, slots: Sequence[ReplySlot], delivery: _Delivery) -> None:
        """Schedule the reply of each slot; overlapping transmissions collide."""
        if not slots:
            return
        byte_s, at_s = delivery.speech.byte_s, delivery.at_s
        speeches: list[_BusTransmission] = []
        for slot in slots:
            slot_s = 0.0 if slot.slot is None else slot.slot * (PING_PACKET * byte_s + PING_PAUSE_S)
            base_s = at_s if slot.slot is None else delivery.at_s + slot_s
            if not slot.replies:
                at_s += slot.size * byte_s + FRAME_TIMEOUT_S
            for reply in slot.replies:
                speech = self._make_transmission(reply, base_s, byte_s, prompt=slot.prompt)
                speeches.append(speech)
                at_s = max(at_s, speech.end_s)
        self._replies = [s for s in self._replies if s.end_s > delivery.at_s]
        for speech in _merge_overlapping(speeches):
            self._deliver_reply(speech)

    def _make_transmission(
        self, reply: Reply, base_s: float, byte_s: float, *, prompt: bool
    ) -> _BusTransmission:
        servo = reply.servo
        delay_s = 0.0 if prompt else servo.return_delay_s + servo.random.random() * CRYSTAL_S
        speech = _BusTransmission(base_s + delay_s, byte_s, reply.data, servo)
        if not servo.hears_while_replying:
            servo.replying_until_s = speech.end_s
        return speech

    def _deliver_reply(self, speech: _BusTransmission) -> None:
        """Send a reply to the host, unless the host itself is transmitting."""
        if speech.start_s < self.host_end_s:
            self._garble_both_ways(speech)
        self._replies.append(speech)
        for witness in self.witnesses:
            witness.on_reply(speech.start_s, speech.servo, speech.data)
        start_s, byte_s, receive = speech.start_s, speech.byte_s, self.adapter.receive_from_line
        if not self.faults.changes_replies and not self.options.noise:
            receive(start_s, byte_s, speech.data)
            return
        for delay_s, data in self.faults.faulty_arrivals(speech.servo, start_s, speech.data):
            receive(start_s + delay_s, byte_s, self._add_noise(data))

    def _garble_both_ways(self, speech: _BusTransmission) -> None:
        """Garble a reply and the host's simultaneous bytes."""
        for host in self._hosts:
            if _is_overlapping(host, speech):
                host.garbled = speech.garbled = True
        if speech.garbled:
            speech.data = self.random.randbytes(len(speech.data))

    def _add_noise(self, data: bytes) -> bytes:
        chance = self.options.noise
        if not chance:
            return data
        flips = (
            1 << self.random.randrange(8) if self.random.random() < chance else 0 for _ in data
        )
        return bytes(byte ^ flip for byte, flip in zip(data, flips, strict=True))

    def _reset_partial_frames(self) -> None:
        for reader in self.readers.values():
            reader.reset()


def _is_overlapping(one: _BusTransmission, other: _BusTransmission) -> bool:
    """Check whether two transmissions overlap, beyond rounding of byte times."""
    return one.start_s < other.end_s - ROUNDING_S and other.start_s < one.end_s - ROUNDING_S


def _merge_overlapping(speeches: list[_BusTransmission]) -> list[_BusTransmission]:
    """Merge overlapping transmissions into the one that a receiver reads."""
    if all(one.end_s <= other.start_s for one, other in itertools.pairwise(speeches)):
        return speeches
    merged: list[_BusTransmission] = []
    for speech in sorted(speeches, key=lambda speech: speech.start_s):
        before = merged[-1] if merged else None
        if before is None or speech.start_s >= before.end_s - ROUNDING_S:
            merged.append(speech)
            continue
        both = [(before.start_s, before.data), (speech.start_s, speech.data)]
        start_s, data = resolve_collision(both, speech.byte_s)
        merged[-1] = _BusTransmission(start_s, speech.byte_s, data)
    return merged
