"""Decode the recorded bytes of a line into instructions and replies with times and errors."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from ikservo.hardware.packet_log import LoggedBytes
from ikservo.hardware.packets import BROADCAST_ID
from ikservo.hardware.protocols.protocol1 import checksum
from ikservo.hardware.protocols.protocol2 import MAX_PACKET_BYTES, crc, split_fast_sync, unstuff
from ikservo.registers import ControlTable, Register


@dataclass(frozen=True, slots=True)
class DecodedPacket:
    """A packet, or bytes that are not a packet.

    Attributes:
        time_s: Time of its first byte, seconds.
        sent: Whether it is an instruction; a reply otherwise.
        servo_id: The servo id; 254: all servos; None if the bytes are not a packet.
        meaning: The packet in words.
        error: The error of the packet; empty without an error.
        data: The bytes of the packet.
    """

    time_s: float
    sent: bool
    servo_id: int | None
    meaning: str
    error: str
    data: bytes


_INSTRUCTIONS = {
    0x01: "ping", 0x02: "read", 0x03: "write", 0x04: "prepare a write of", 0x05: "action",
    0x06: "factory reset", 0x08: "reboot", 0x10: "clear", 0x20: "control table backup",
    0x82: "sync read", 0x83: "sync write", 0x8A: "fast sync read", 0x92: "bulk read",
    0x93: "bulk write", 0x9A: "fast bulk read",
}  # fmt: skip
_READ, _WRITE, _REG_WRITE, _SYNC_READ, _SYNC_WRITE, _FAST_SYNC_READ = 2, 3, 4, 0x82, 0x83, 0x8A
_BULK_READ, _STATUS = 0x92, 0x55
_HEADER_1, _HEADER_2 = b"\xff\xff", b"\xff\xff\xfd\x00"


@dataclass(frozen=True, slots=True)
class _Frame:
    """The common parts of packets of both protocols.

    Attributes:
        servo_id: The servo id.
        code: The instruction, or the error byte of a reply.
        data: The parameters of the packet.
        wide: Whether it belongs to protocol 2.0, with addresses of two bytes.
    """

    servo_id: int
    code: int
    data: bytes
    wide: bool


def decode_packets(
    logged: Iterable[LoggedBytes], tables: Mapping[int, type[ControlTable]]
) -> Iterator[DecodedPacket]:
    """Decode the packets of a recording, in order.

    Registers of ids without a control table are shown as addresses.
    """
    decoder = _Decoder(tables)
    for chunk in logged:
        yield from decoder.decode_sent(chunk) if chunk.sent else decoder.decode_received(chunk)
    yield from decoder.flush()


class _Decoder:
    """Decoder of replies, with the help of the latest instruction."""

    def __init__(self, tables: Mapping[int, type[ControlTable]]) -> None:
        self._tables = tables
        self._sent = b""
        self._received = bytearray()
        self._since_s = 0.0
        self._spans: dict[int, tuple[int, int]] = {}
        self._fast_ids: tuple[int, ...] = ()

    def decode_sent(self, chunk: LoggedBytes) -> Iterator[DecodedPacket]:
        yield from self.flush()
        frame, end = _parse_frame(chunk.data, 0, status=False)
        if frame is None or end < len(chunk.data):
            yield DecodedPacket(chunk.time_s, True, None, "bytes", "no packet", chunk.data)
            return
        self._sent = chunk.data
        self._note_spans(frame)
        yield DecodedPacket(
            chunk.time_s, True, frame.servo_id, self._describe(frame), "", chunk.data
        )

    def decode_received(self, chunk: LoggedBytes) -> Iterator[DecodedPacket]:
        if not self._received:
            self._since_s = chunk.time_s
        self._received += chunk.data
        yield from self._parse_received(final=False)

    def flush(self) -> Iterator[DecodedPacket]:
        """Decode the bytes that were received before the next instruction."""
        yield from self._parse_received(final=True)

    def _parse_received(self, *, final: bool) -> Iterator[DecodedPacket]:
        received, at = self._received, 0
        if self._sent and received.startswith(self._sent):  # the adapter echoes sent bytes
            at, self._sent = len(self._sent), b""
        while at < len(received):
            frame, end = _parse_frame(received, at, status=True)
            if frame is not None:
                yield self._decode_status(frame, bytes(received[at:end]))
            elif final:
                header_at = received.find(_HEADER_1, at + 1)
                end = len(received) if header_at < 0 else header_at
                junk = bytes(received[at:end])
                yield DecodedPacket(self._since_s, False, None, "bytes", "no packet", junk)
            else:
                break
            at = end
        del received[:at]

    def _decode_status(self, frame: _Frame, data: bytes) -> DecodedPacket:
        error = f"error 0x{frame.code:02X}" if frame.code else ""
        meaning = "ok"
        if self._fast_ids and frame.servo_id == BROADCAST_ID:
            address, size = self._spans[self._fast_ids[0]]
            parts = split_fast_sync(bytes((frame.code, *frame.data)), self._fast_ids, size)
            meaning = "; ".join(
                f"{p.servo_id}: {self._describe_data(p.servo_id, address, p.data)}" for p in parts
            )
        elif frame.servo_id in self._spans and frame.data:
            address, size = self._spans[frame.servo_id]
            if size == len(frame.data):
                meaning = self._describe_data(frame.servo_id, address, frame.data)
        elif frame.data:
            meaning = f"{len(frame.data)} bytes"
        return DecodedPacket(self._since_s, False, frame.servo_id, meaning, error, data)

    def _note_spans(self, frame: _Frame) -> None:
        """Store the address range that is requested from each servo."""
        width, data = 2 if frame.wide else 1, frame.data
        self._spans, self._fast_ids = {}, ()
        if frame.code in (_READ, _SYNC_READ, _FAST_SYNC_READ) and len(data) >= 2 * width:
            span = _word(data, 0, width), _word(data, width, width)
            ids = (frame.servo_id,) if frame.code == _READ else tuple(data[2 * width :])
            self._spans = dict.fromkeys(ids, span)
            self._fast_ids = ids if frame.code == _FAST_SYNC_READ else ()
        elif frame.code == _BULK_READ and frame.wide:
            rows = (data[at : at + 5] for at in range(0, len(data) - 4, 5))
            self._spans = {row[0]: (_word(row, 1, 2), _word(row, 3, 2)) for row in rows}
        elif frame.code == _BULK_READ:
            rows = (data[at : at + 3] for at in range(1, len(data) - 2, 3))
            self._spans = {row[1]: (row[2], row[0]) for row in rows}

    def _describe(self, frame: _Frame) -> str:
        name = _INSTRUCTIONS.get(frame.code, f"instruction 0x{frame.code:02X}")
        width, data = 2 if frame.wide else 1, frame.data
        if self._spans:
            texts = {self._describe_span(i, *span) for i, span in self._spans.items()}
            servos = "" if frame.code == _READ else f" of {', '.join(map(str, self._spans))}"
            return f"{name} {'; '.join(sorted(texts))}{servos}"
        if frame.code in (_WRITE, _REG_WRITE) and len(data) > width:
            address = _word(data, 0, width)
            return f"{name} {self._describe_data(frame.servo_id, address, data[width:])}"
        if frame.code == _SYNC_WRITE and len(data) > 2 * width:
            address, size = _word(data, 0, width), _word(data, width, width)
            rows = (data[at : at + 1 + size] for at in range(2 * width, len(data) - size, size + 1))
            texts = [f"{row[0]}: {self._describe_data(row[0], address, row[1:])}" for row in rows]
            return f"{name} {'; '.join(texts)}"
        return name

    def _describe_span(self, servo_id: int, address: int, size: int) -> str:
        registers = self._registers(servo_id, address, size)
        if not registers:
            return f"{address} ({size} bytes)"
        first, last = registers[0].name, registers[-1].name
        return first if first == last else f"{first} to {last}"

    def _describe_data(self, servo_id: int, address: int, data: bytes) -> str:
        registers = self._registers(servo_id, address, len(data))
        if not registers:
            return f"{address} = {data.hex(' ').upper()}"
        values = (
            f"{each.name} = {each.decode(data[each.address - address : each.end - address])}"
            for each in registers
        )
        return ", ".join(values)

    def _registers(self, servo_id: int, address: int, size: int) -> list[Register]:
        table = self._tables.get(servo_id)
        if table is None:
            return []
        rows = table.registers.values()
        return [r for r in rows if address <= r.address and r.end <= address + size]


def _parse_frame(data: bytes | bytearray, at: int, *, status: bool) -> tuple[_Frame | None, int]:
    """Parse the packet that begins at an index; return it and its end."""
    start = data[at : at + 7]
    if start.startswith(_HEADER_2):
        length = int.from_bytes(start[5:], "little")
        # Without a limit, each false header would cost a checksum over up to 64 KiB.
        if len(start) < 7 or not 3 <= length <= MAX_PACKET_BYTES:
            return None, at
        end = at + 7 + length
        packet = bytes(data[at:end])
        if end > len(data) or crc(0, packet, len(packet) - 2) != _word(packet, len(packet) - 2, 2):
            return None, at
        inside = unstuff(packet[7:-2])
        if (inside[0] == _STATUS) != status or (status and len(inside) < 2):
            return None, at
        code, parameters = (inside[1], inside[2:]) if status else (inside[0], inside[1:])
        return _Frame(packet[4], code, parameters, wide=True), end
    if start.startswith(_HEADER_1) and len(start) >= 4:
        end = at + start[3] + 4
        packet = bytes(data[at:end])
        if end > len(data) or len(packet) < 6 or packet[-1] != checksum(packet[2:-1]):
            return None, at
        return _Frame(packet[2], packet[4], packet[5:-1], wide=False), end
    return None, at


def _word(data: bytes, at: int, width: int) -> int:
    return int.from_bytes(data[at : at + width], "little")
