"""The half-duplex line: bytes take their time, servos hear, wait, answer and collide."""

from __future__ import annotations

import heapq
import itertools
import random
from collections.abc import Sequence
from dataclasses import dataclass

from servosim.frames import Dynamixel1Reader, Dynamixel2Reader, Frame, FrameReader
from servosim.inbox import Inbox
from servosim.servo import Protocol, Servo
from servosim.talk import ANSWERS, Turn
from servosim.wire import collide
from servosim.world import World

__all__ = ["Line", "LineOptions"]

BITS_PER_BYTE = 10
PING_PACKET = 14  # bytes of the longest ping status: a slot of the broadcast ping
PING_PAUSE_S = 0.0005  # between two slots
PATIENCE_S = 0.0005  # assumed: how much longer than a reply the next in a sync read waits
CRYSTAL_S = 4e-6  # spread of a servo's reaction time

_FRAMING: dict[Protocol, type[FrameReader]] = {
    Protocol.DYNAMIXEL_2: Dynamixel2Reader,
    Protocol.DYNAMIXEL_1: Dynamixel1Reader,
    Protocol.FEETECH: Dynamixel1Reader,
}


@dataclass(frozen=True, slots=True)
class LineOptions:
    """How the line behaves.

    Attributes:
        wire_time: Whether bytes take time at all.
        gap_s: A pause between bytes after which a servo gives up an unfinished frame.
        seed: Of all chance on the line.
    """

    wire_time: bool = True
    gap_s: float = 0.0015
    seed: int = 0


@dataclass(slots=True)
class _Speech:
    """Bytes somebody puts on the line."""

    start_s: float
    end_s: float
    data: bytes
    garbled: bool = False


@dataclass(slots=True)
class _Heard:
    """A frame that servos will have heard completely at ``at_s``."""

    at_s: float
    protocol: Protocol
    baud: int
    frame: Frame
    speech: _Speech


class Line:
    """The wire between a host's adapter and its servos, in the time of whoever drives it.

    The owner of a clock calls ``host_write`` when the host writes and ``run_until`` when time
    has passed; replies pile up in ``inbox`` with the moments at which they arrive, and
    ``host_end_s`` is when the host's last byte will have left.
    """

    def __init__(self, world: World, baud: int, options: LineOptions | None = None) -> None:
        self.world = world
        self.options = options or LineOptions()
        self.inbox = Inbox()
        self.random = random.Random(self.options.seed)  # noqa: S311 - chance on a wire
        self.baud = baud
        self._readers = {
            protocol: _FRAMING[protocol]()
            for protocol in Protocol
            if any(servo.protocol is protocol for servo in world.servos)
        }
        self.host_end_s = self._last_byte_s = 0.0
        self._due: list[tuple[float, int, _Heard]] = []
        self._order = itertools.count()
        self._host_speech: list[_Speech] = []
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
            for reader in self._readers.values():
                reader.reset()

    def host_write(self, data: bytes, now_s: float) -> float:
        """Put bytes on the line behind those already there; return when the last has left."""
        self.run_until(now_s)
        start_s = max(now_s, self.host_end_s)
        if start_s - self._last_byte_s > self.options.gap_s:
            for reader in self._readers.values():
                reader.reset()
        speech = _Speech(start_s, start_s + len(data) * self.byte_s, data)
        self.host_end_s = self._last_byte_s = speech.end_s
        self._overlap_replies(speech)
        self._host_speech = [s for s in self._host_speech if s.end_s > now_s] + [speech]
        for protocol, reader in self._readers.items():
            for frame in reader.feed(data):
                at_s = start_s + frame.end * self.byte_s
                heard = _Heard(at_s, protocol, self.baud, frame, speech)
                heapq.heappush(self._due, (at_s, next(self._order), heard))
        return speech.end_s

    def run_until(self, now_s: float) -> None:
        """Let time pass: servos turn, hear the frames that have come through, and answer."""
        while self._due and self._due[0][0] <= now_s:
            heard = heapq.heappop(self._due)[2]
            self.world.advance_to(heard.at_s)
            if not heard.speech.garbled:
                self._hear(heard)
        self.world.advance_to(now_s)

    def _hear(self, heard: _Heard) -> None:
        servos = [
            servo
            for servo in self.world.servos
            if servo.protocol is heard.protocol and servo.hears(heard.baud, heard.at_s)
        ]
        if servos:
            self._schedule(ANSWERS[heard.protocol](heard.frame, servos), heard)

    def _schedule(self, turns: Sequence[Turn], heard: _Heard) -> None:
        byte_s = BITS_PER_BYTE / heard.baud if self.options.wire_time else 0.0
        speeches: list[_Speech] = []
        at_s = heard.at_s
        for turn in turns:
            base_s = at_s
            if turn.slot is not None:
                base_s = heard.at_s + turn.slot * (PING_PACKET * byte_s + PING_PAUSE_S)
            for reply in turn.replies:
                delay_s = 0.0 if turn.prompt else self._reaction_s(reply.servo)
                start_s = base_s + delay_s
                speech = _Speech(start_s, start_s + len(reply.data) * byte_s, reply.data)
                speeches.append(speech)
                at_s = max(at_s, speech.end_s)
            if not turn.replies:
                at_s += turn.size * byte_s + PATIENCE_S
        for speech in _merge(speeches, byte_s):
            self._deliver(speech, byte_s)

    def _reaction_s(self, servo: Servo) -> float:
        return servo.return_delay_s + servo.random.random() * CRYSTAL_S

    def _deliver(self, speech: _Speech, byte_s: float) -> None:
        """Send a reply to the host, unless the host itself is speaking over it."""
        for host in self._host_speech:
            if host.start_s < speech.end_s and speech.start_s < host.end_s:
                host.garbled = speech.garbled = True
        if speech.garbled:
            speech.data = bytes(self.random.randbytes(len(speech.data)))
        self._replies = [s for s in self._replies if s.end_s > self.world.time_s] + [speech]
        self.inbox.add(speech.start_s, byte_s, speech.data)

    def _overlap_replies(self, speech: _Speech) -> None:
        """Garble what the host says into a reply that is still on the line."""
        for reply in self._replies:
            if reply.start_s < speech.end_s and speech.start_s < reply.end_s:
                speech.garbled = True


def _merge(speeches: list[_Speech], byte_s: float) -> list[_Speech]:
    """Turn speeches that overlap into the one that a receiver makes of them."""
    if len(speeches) < 2:
        return speeches
    merged: list[_Speech] = []
    group: list[_Speech] = []
    for speech in sorted(speeches, key=lambda speech: speech.start_s):
        if group and speech.start_s >= max(s.end_s for s in group) - 1e-9:
            merged.append(_mixed(group, byte_s))
            group = []
        group.append(speech)
    merged.append(_mixed(group, byte_s))
    return merged


def _mixed(group: list[_Speech], byte_s: float) -> _Speech:
    if len(group) == 1:
        return group[0]
    start_s, data = collide([(speech.start_s, speech.data) for speech in group], byte_s)
    return _Speech(start_s, start_s + len(data) * byte_s, data)
