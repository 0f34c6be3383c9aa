"""Ping all ids at one baud rate, in every known framing.

Feetech servos and Dynamixel protocol 1.0 share one framing, so that one ping finds both; protocol
2.0 has its own.

An answer names the servo that gives it, so the next question may go out as soon as the wire is
free; what a slow adapter holds back arrives later and is understood all the same.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from ikservo.hardware import protocol1 as protocol_1
from ikservo.hardware.packets import LONGEST_RETURN_DELAY_S, ScanResult, StatusPacket
from ikservo.hardware.port import Port
from ikservo.registers import MODELS, Family

__all__ = ["FRAMINGS", "Framing", "PingResults", "framing_of", "ping_ids"]


_PING = 0x01


class _PacketScanner(Protocol):
    """How one framing is written and read."""

    def ping(self, servo_id: int) -> bytes: ...
    def scan(self, heard: bytes, *, final: bool) -> ScanResult: ...


@dataclass(frozen=True, slots=True)
class Framing:
    """One way to write packets.

    Attributes:
        name: For messages.
        families: The dialects that use it.
        ids: Which ids a servo can have.
        ping_bytes: Length of the question.
        answer_bytes: Length of the answer.
    """

    name: str
    families: tuple[Family, ...]
    ids: range
    ping_bytes: int
    answer_bytes: int

    @property
    def baud_rates(self) -> frozenset[int]:
        """Return every rate that a known model of these families can be set to."""
        tables = [table for table in MODELS.values() if table.family in self.families]
        return frozenset(rate for table in tables for rate in table.baud_rates.values())

    def make_scanner(self) -> _PacketScanner:
        """Return what writes and reads it; the vendor's SDK is imported only now."""
        return _Protocol2Framing() if Family.DYNAMIXEL_2 in self.families else _Protocol1Framing()


FRAMINGS = (
    Framing(
        "Feetech and Dynamixel 1.0",
        (Family.FEETECH_STS, Family.FEETECH_SCS, Family.DYNAMIXEL_1),
        ids=range(254),
        ping_bytes=6,
        answer_bytes=6,
    ),
    Framing("Dynamixel 2.0", (Family.DYNAMIXEL_2,), ids=range(253), ping_bytes=10, answer_bytes=14),
)


def framing_of(family: Family) -> Framing:
    """Return the framing that a family uses."""
    return next(framing for framing in FRAMINGS if family in framing.families)


class _PacketRecorder:
    """Takes a packet down where the vendors' handlers think they send it.

    Really sending it through them would discard what earlier servos have just answered (they
    clear the input first), and pings are sent while answers to others are still under way.
    """

    is_using = False
    packet = b""

    def clearPort(self) -> None:  # noqa: N802 (the SDKs call it)
        pass

    def writePort(self, packet: Sequence[int]) -> int:  # noqa: N802 (the SDKs call it)
        self.packet = bytes(packet)
        return len(packet)


class _Protocol1Framing:
    def __init__(self) -> None:
        from scservo_sdk.protocol_packet_handler import protocol_packet_handler  # noqa: PLC0415

        self._handler = protocol_packet_handler()

    def ping(self, servo_id: int) -> bytes:
        sheet = _PacketRecorder()
        self._handler.txPacket(sheet, [0, 0, servo_id, 2, _PING, 0])
        return sheet.packet

    def scan(self, heard: bytes, *, final: bool) -> ScanResult:
        return protocol_1.scan_packets(heard, (0,), final=final)


class _Protocol2Framing:
    def __init__(self) -> None:
        from dynamixel_sdk.protocol2_packet_handler import Protocol2PacketHandler  # noqa: PLC0415
        from dynamixel_sdk.robotis_def import COMM_TX_ERROR  # noqa: PLC0415

        from ikservo.hardware.protocol2 import Protocol2Codec  # noqa: PLC0415

        self._handler = Protocol2PacketHandler()
        self._answers = Protocol2Codec(COMM_TX_ERROR)

    def ping(self, servo_id: int) -> bytes:
        sheet = _PacketRecorder()
        self._handler.txPacket(sheet, [0, 0, 0, 0, servo_id, 3, 0, _PING, 0, 0])
        return sheet.packet

    def scan(self, heard: bytes, *, final: bool) -> ScanResult:
        return self._answers.scan(heard, (3,), final=final)


_USB_FRAME_S = 0.001  # two packets may leave the adapter so much closer than they were written
_ECHO_ERROR = 1  # a ping of protocol 1 reads like an answer with this error byte
_ADAPTER_DELAY_S = 0.040  # adapters keep bytes for up to 16 ms, busy machines for longer
_QUIET_S = 3  # pings of one id in vain that are enough
_RECENT_PINGS = 20  # pings that an adapter may hold the answer back for
_READ_CHUNK_BYTES = 4096  # bytes; more than any slot brings


@dataclass(slots=True)
class PingResults:
    """Who spoke.

    Attributes:
        frames: Every answer by id, in the order in which they came.
        suspects: Ids in whose time bytes came that are no answer: two servos at once, or noise.
        junk: How many such bytes.
        echoes: Whether the adapter hears itself.
    """

    frames: dict[int, list[StatusPacket]] = field(default_factory=dict[int, "list[StatusPacket]"])
    suspects: set[int] = field(default_factory=set[int])
    junk: int = 0
    echoes: bool = False


def ping_ids(
    port: Port,
    framing: Framing,
    servo_ids: Iterable[int],
    on_ping: Callable[[int], None] | None = None,
    *,
    echoes: bool | None = None,
    calm: bool = False,
) -> PingResults:
    """Ping ids one after the other at the port's baud rate.

    Args:
        port: The line.
        framing: How to write.
        servo_ids: Whom to ask; an id may come several times.
        on_ping: Called with the number of pings sent so far.
        echoes: Whether the adapter hears itself; None finds out, which takes several ids.
        calm: Wait for each answer, and a while longer for a second one; gives up where the first
            pings bring nothing.

    Raises:
        PortLostError: The line is gone.
    """
    ids = list(servo_ids)
    ear = _ScanReceiver(framing)
    with port.exchange():
        port.clearPort()
        for count, servo_id in enumerate(ids, start=1):
            port.writePort(ear.ping_packet(servo_id))
            ear.feed(_receive_until_slot_end(port, framing, calm=calm))
            if on_ping:
                on_ping(count)
            if calm and count == _QUIET_S and not ear.has_received:
                break
        tail_s = 0.0 if calm else _ADAPTER_DELAY_S
        ear.feed(port.read_until(_READ_CHUNK_BYTES, port.clock.now_s() + tail_s), final=True)
    return ear.make_results(ids, echoes)


def _receive_until_slot_end(port: Port, framing: Framing, *, calm: bool) -> bytes:
    """Return what comes until the next ping may go out."""
    first = b""
    if calm:
        first = port.read_until(1, port.clock.now_s() + _ADAPTER_DELAY_S)
    return first + port.read_until(
        _READ_CHUNK_BYTES, port.clock.now_s() + ping_slot_s(port, framing)
    )


def ping_slot_s(port: Port, framing: Framing) -> float:
    """Return after what time the next ping cannot run into the answer to this one."""
    on_wire_s = port.wire_s(framing.ping_bytes + framing.answer_bytes)
    return on_wire_s + LONGEST_RETURN_DELAY_S + _USB_FRAME_S


class _ScanReceiver:
    """Finds the answers in what comes, and remembers whose turn it was when rubbish came."""

    def __init__(self, framing: Framing) -> None:
        self._dialect = framing.make_scanner()
        self._pending = b""
        self._lately: list[int] = []
        self._sweep = PingResults()

    @property
    def has_received(self) -> bool:
        """Whether any byte came."""
        return bool(self._pending or self._sweep.frames or self._sweep.junk)

    def ping_packet(self, servo_id: int) -> bytes:
        """Return the packet that asks an id."""
        self._lately = [*self._lately[-_RECENT_PINGS:], servo_id]
        return self._dialect.ping(servo_id)

    def feed(self, data: bytes, *, final: bool = False) -> None:
        """Take down what came since the last call."""
        said = self._pending + data
        heard = self._dialect.scan(said, final=final)
        self._pending = said[len(said) - heard.pending :]
        for frame in heard.frames:
            self._sweep.frames.setdefault(frame.servo_id, []).append(frame)
        if heard.junk:
            self._sweep.junk += heard.junk
            self._sweep.suspects.update(self._lately)

    def make_results(self, ids: list[int], echoes: bool | None) -> PingResults:
        """Return who spoke besides ourselves."""
        asked, said = Counter(ids), self._sweep
        said.echoes = self._echoes_own_pings(asked) if echoes is None else echoes
        if said.echoes:
            for servo_id, count in asked.items():
                self._drop_echoes(servo_id, count)
        said.frames = {i: rows for i, rows in said.frames.items() if rows and i in asked}
        return said

    def _echoes_own_pings(self, asked: Counter[int]) -> bool:
        """An adapter that hears itself repeats every ping; a servo can do so with its own only."""
        return len(asked) > 1 and all(len(self._echo_frames(i)) >= asked[i] for i in asked)

    def _drop_echoes(self, servo_id: int, count: int) -> None:
        for echo in self._echo_frames(servo_id)[:count]:
            self._sweep.frames[servo_id].remove(echo)

    def _echo_frames(self, servo_id: int) -> list[StatusPacket]:
        return [f for f in self._sweep.frames.get(servo_id, ()) if _is_ping_frame(f)]


def _is_ping_frame(frame: StatusPacket) -> bool:
    return frame.error == _ECHO_ERROR and not frame.data
