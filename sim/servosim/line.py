"""The half-duplex line: bytes take their time, servos hear, wait, answer and collide."""

from __future__ import annotations

import heapq
import itertools
import random
from collections.abc import Sequence
from dataclasses import dataclass, field

from servosim.adapter import Adapter, AdapterOptions
from servosim.collision import collide
from servosim.errors import SimulatorError
from servosim.faults import FaultScript
from servosim.frames import Frame, FrameReader
from servosim.inbox import Inbox
from servosim.protocol import Protocol
from servosim.servo import Servo
from servosim.talk import ANSWERS, Reply, Turn
from servosim.traffic import Witness
from servosim.world import World

__all__ = ["Line", "LineOptions"]

BITS_PER_BYTE = 10
PING_PACKET = 14  # bytes of the longest ping status: a slot of the broadcast ping
PING_PAUSE_S = 0.0005  # assumed: between two slots
PATIENCE_S = 0.0005  # assumed: how much longer than a reply the next in a sync read waits
ROUNDING_S = 1e-9
CRYSTAL_S = 4e-6  # assumed: spread of a servo's reaction time


@dataclass(frozen=True, slots=True)
class LineOptions:
    """How the line behaves.

    Attributes:
        wire_time: Whether bytes take time at all.
        gap_s: A pause between bytes after which a servo gives up an unfinished frame.
        noise: Chance of each byte to have one bit flipped.
        seed: Of all chance on the line.
        adapter: The host's adapter.
    """

    wire_time: bool = True
    gap_s: float = 0.0015
    noise: float = 0.0
    seed: int = 0
    adapter: AdapterOptions = field(default_factory=AdapterOptions)

    def __post_init__(self) -> None:
        if not 0.0 <= self.noise <= 1.0:
            raise SimulatorError(f"noise is a chance from 0 to 1, not {self.noise}")


@dataclass(slots=True)
class _Speech:
    """Bytes somebody puts on the line."""

    start_s: float
    byte_s: float
    data: bytes
    servo: Servo | None = None
    garbled: bool = False
    end_s: float = field(init=False)

    def __post_init__(self) -> None:
        self.end_s = self.start_s + len(self.data) * self.byte_s


@dataclass(slots=True)
class _Heard:
    """A frame that servos will have heard completely at ``at_s``."""

    at_s: float
    framing: type[FrameReader]
    baud: int
    frame: Frame
    speech: _Speech


class Line:
    """The wire between a host's adapter and its servos, in the time of whoever drives it.

    The owner of a clock calls ``host_write`` when the host writes and ``run_until`` when time
    has passed; replies pile up in ``inbox`` with the moments at which they arrive, and
    ``host_end_s`` is when the host's last byte will have left.

    Attributes:
        world: The servos and what they move.
        baud: The host's rate.
        inbox: What is on its way to the host.
        faults: What goes wrong.
        witnesses: Who is told of every frame.
        plugged: False while the adapter's cable is pulled.
    """

    def __init__(self, world: World, baud: int, options: LineOptions | None = None) -> None:
        self.world, self.baud = world, baud
        self.options = options or LineOptions()
        self.inbox = Inbox()
        self.adapter = Adapter(self.inbox, self.options.adapter)
        self.random = random.Random(self.options.seed)  # noqa: S311 - chance on a wire
        self.faults = FaultScript(self, self.options.seed)
        self.witnesses: list[Witness] = []
        self.plugged = True
        self.readers: dict[type[FrameReader], FrameReader] = {}
        self.host_end_s = 0.0
        self._due: list[tuple[float, int, _Heard]] = []
        self._order = itertools.count()
        self._hosts: list[_Speech] = []
        self._replies: list[_Speech] = []

    @property
    def servos(self) -> dict[int, Servo]:
        """The servos by id; of two with one id the first."""
        found: dict[int, Servo] = {}
        for servo in self.world.servos:
            found.setdefault(servo.id, servo)
        return found

    @property
    def byte_s(self) -> float:
        """Time of one byte at the host's baud rate [s]."""
        return BITS_PER_BYTE / self.baud if self.options.wire_time else 0.0

    @property
    def heard_all_s(self) -> float:
        """When everything the host has written will have been heard."""
        return max((at_s for at_s, _, _ in self._due), default=self.host_end_s)

    @property
    def next_s(self) -> float | None:
        """When the next frame will have been heard, or None when the line is idle."""
        return self._due[0][0] if self._due else None

    def set_baud(self, baud: int) -> None:
        """Set the host's rate; servos at another rate see noise and forget half a frame."""
        if baud != self.baud:
            self.baud = baud
            self._forget_half_frames()

    def host_write(self, data: bytes, now_s: float) -> float:
        """Put bytes on the line behind those already there; return when the last has left."""
        self.run_until(now_s)
        start_s = max(self.adapter.departure_s(now_s), self.host_end_s)
        if start_s - self.host_end_s > self.options.gap_s:
            self._forget_half_frames()
        speech = _Speech(start_s, self.byte_s, self._noisy(data))
        self.host_end_s = speech.end_s
        self._garble_overlapped(speech)
        self._hosts = [s for s in self._hosts if s.end_s > now_s]
        self._hosts.append(speech)
        self.adapter.sent(start_s, speech.byte_s, speech.data)
        for framing in {servo.framing for servo in self.world.servos}:
            self._listen(framing, speech)
        return speech.end_s

    def run_until(self, now_s: float) -> None:
        """Let time pass: servos turn, hear the frames that have come through, and answer."""
        while self._due and self._due[0][0] <= now_s:
            heard = heapq.heappop(self._due)[2]
            self.world.advance_to(heard.at_s)
            if not heard.speech.garbled and not self.faults.instruction_lost(heard.at_s):
                self._hear(heard)
        self.world.advance_to(now_s)

    def _listen(self, framing: type[FrameReader], speech: _Speech) -> None:
        reader = self.readers.get(framing)
        if reader is None:
            reader = self.readers[framing] = framing()
        for frame in reader.feed(speech.data):
            at_s = speech.start_s + frame.end * speech.byte_s
            heard = _Heard(at_s, framing, self.baud, frame, speech)
            heapq.heappush(self._due, (at_s, next(self._order), heard))

    def _hear(self, heard: _Heard) -> None:
        groups: dict[Protocol, list[Servo]] = {}
        for servo in self.world.servos:
            if servo.framing is heard.framing and servo.hears(heard.baud, heard.at_s):
                groups.setdefault(servo.protocol, []).append(servo)
        for witness in self.witnesses:
            witness.heard(heard.at_s, heard.frame, heard.framing)
        for protocol, servos in groups.items():
            self._schedule(ANSWERS[protocol](heard.frame, servos), heard)

    def _schedule(self, turns: Sequence[Turn], heard: _Heard) -> None:
        """Give every turn its time; the speeches that overlap collide."""
        byte_s = heard.speech.byte_s
        at_s = heard.at_s
        speeches: list[_Speech] = []
        for turn in turns:
            slot_s = 0.0 if turn.slot is None else turn.slot * (PING_PACKET * byte_s + PING_PAUSE_S)
            base_s = at_s if turn.slot is None else heard.at_s + slot_s
            if not turn.replies:
                at_s += turn.size * byte_s + PATIENCE_S
            for reply in turn.replies:
                speech = self._speech(reply, base_s, byte_s, prompt=turn.prompt)
                speeches.append(speech)
                at_s = max(at_s, speech.end_s)
        self._replies = [s for s in self._replies if s.end_s > heard.at_s]
        for speech in _merge(speeches):
            self._deliver(speech)

    def _speech(self, reply: Reply, base_s: float, byte_s: float, *, prompt: bool) -> _Speech:
        servo = reply.servo
        delay_s = 0.0 if prompt else servo.return_delay_s + servo.random.random() * CRYSTAL_S
        return _Speech(base_s + delay_s, byte_s, reply.data, servo)

    def _deliver(self, speech: _Speech) -> None:
        """Send a reply to the host, unless the host itself is speaking over it."""
        for host in self._hosts:
            if _overlap(host, speech):
                host.garbled = speech.garbled = True
        if speech.garbled:
            speech.data = self.random.randbytes(len(speech.data))
        self._replies.append(speech)
        for witness in self.witnesses:
            witness.said(speech.start_s, speech.servo, speech.data)
        for delay_s, data in self.faults.replies(speech.servo, speech.start_s, speech.data):
            self.adapter.received(speech.start_s + delay_s, speech.byte_s, self._noisy(data))

    def _garble_overlapped(self, speech: _Speech) -> None:
        """Garble what the host says into a reply that is still on the line."""
        for reply in self._replies:
            if _overlap(reply, speech):
                speech.garbled = True

    def _noisy(self, data: bytes) -> bytes:
        chance = self.options.noise
        if not chance:
            return data
        flips = (
            1 << self.random.randrange(8) if self.random.random() < chance else 0 for _ in data
        )
        return bytes(byte ^ flip for byte, flip in zip(data, flips, strict=True))

    def _forget_half_frames(self) -> None:
        for reader in self.readers.values():
            reader.reset()


def _overlap(one: _Speech, other: _Speech) -> bool:
    """Return whether two speak at once, by more than sums of byte times are wrong."""
    return one.start_s < other.end_s - ROUNDING_S and other.start_s < one.end_s - ROUNDING_S


def _merge(speeches: list[_Speech]) -> list[_Speech]:
    """Turn speeches that overlap into the one that a receiver makes of them."""
    if len(speeches) < 2:
        return speeches
    merged: list[_Speech] = []
    for speech in sorted(speeches, key=lambda speech: speech.start_s):
        before = merged[-1] if merged else None
        if before is None or speech.start_s >= before.end_s - ROUNDING_S:
            merged.append(speech)
            continue
        both = [(before.start_s, before.data), (speech.start_s, speech.data)]
        start_s, data = collide(both, speech.byte_s)
        merged[-1] = _Speech(start_s, speech.byte_s, data)
    return merged
