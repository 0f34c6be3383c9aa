"""Send one instruction and receive its status packets, despite echoes and late replies."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

from ikservo.errors import BusError, PortLostError
from ikservo.hardware.packets import (
    MAX_RETURN_DELAY_S,
    FaultKind,
    MemoryRange,
    PacketCodec,
    Reply,
    ReplyFault,
    ScanResult,
    Status,
    StatusPacket,
)
from ikservo.hardware.port import Port

_MAX_WAITS = 10  # multiple of the reply timeout, as long as bytes keep coming

_NOTHING = ScanResult((), 0, 0)


class ReplyReader:
    """The bytes received since the latest request, and the replies found in them.

    Args:
        port: The port; the request has just been sent.
        codec: The status packet codec.
        sizes: Bytes of data of each reply, by servo id in the order of the replies.
    """

    def __init__(self, port: Port, codec: PacketCodec, sizes: Mapping[int, int]) -> None:
        self._port, self._codec, self._sizes = port, codec, sizes
        self._expected = sum(map(codec.frame_size, sizes.values()))
        self._raw, self._stale, self._older = bytearray(), 0, 0
        self._scan: ScanResult = _NOTHING
        self._replies: dict[int, Reply] = {}

    def read_replies(self, delays_s: float) -> dict[int, Reply]:
        """Receive until all servos have replied, or until no further reply can arrive.

        Raises:
            PortLostError: The port is lost.
        """
        port = self._port
        due_s = port.expected_at_s(self._expected, delays_s)
        if port.is_clean:
            port.sleep_until_due(self._expected)
        chunk = port.read_until(self._expected, due_s + port.reply_timeout.typical_s)
        alone = len(chunk) == self._expected and port.echoes is False
        if alone and not port.stale_bytes(len(chunk)):  # no other bytes came, which is normal
            replies = self._codec.parse_in_order(chunk, self._sizes)
            if replies is not None:
                port.on_reply(chunk, reply_bytes=self._expected)
                port.health.record(odd=False)
                return replies
        return self._read_remaining(chunk, due_s)

    def _read_remaining(self, chunk: bytes, due_s: float) -> dict[int, Reply]:
        """Continue until all replies are complete, or no missing reply can arrive any more."""
        port, timeout_s = self._port, self._port.reply_timeout.timeout_s
        last, frame_size = next(reversed(self._sizes)), self._codec.frame_size
        deadline_s, limit_s = due_s + timeout_s, due_s + (1 + _MAX_WAITS) * timeout_s
        while True:
            fresh = bool(chunk) and self._add_chunk(chunk)
            self._parse_received(final=False)
            if len(self._replies) == len(self._sizes):
                self._port.on_reply(self._raw, reply_bytes=self._expected)
                surplus = len(self._scan.frames) > len(self._sizes)
                odd = self._stale or self._older > 0 or self._scan.junk or surplus
                self._port.health.record(odd=bool(odd))
                return self._replies
            now_s = port.clock.now_s()
            if last in self._replies and not port.pending.pending_until_s((last,), now_s):
                deadline_s = due_s  # no servo before this one can still reply
            elif fresh and (now_s < deadline_s or len(self._sizes) > 1):
                deadline_s = min(max(deadline_s, now_s + timeout_s), limit_s)
            if now_s >= deadline_s:
                return self._finish_at_deadline()
            there = sum(frame_size(self._sizes[i]) for i in self._replies) + self._scan.pending
            chunk = port.read_some(max(self._expected - there, 1), deadline_s)

    def _add_chunk(self, chunk: bytes) -> bool:
        """Add received bytes; return whether these can belong to replies to this request."""
        self._raw += chunk
        early = self._port.stale_bytes(len(self._raw) + self._stale) - self._stale
        if early > 0:
            del self._raw[:early]
            self._stale += early
        return early <= 0

    def _parse_received(self, *, final: bool) -> None:
        """Find frames and replies in all received bytes, after the echo of the request, if any."""
        raw, sent = bytes(self._raw), self._port.sent
        if self._port.echoes is not False:
            # The reply to a ping may consist of the same bytes as the ping.
            anywhere = self._port.echoes or any(self._sizes.values())
            self._older = raw.find(sent) if anywhere else raw.startswith(sent) - 1
            if self._older >= 0:
                raw = raw[self._older + len(sent) :]
            elif not final and sent.startswith(raw):
                raw = b""  # the echo is not complete yet
        self._scan = self._scan_packets(raw, final=final) if raw else _NOTHING
        self._replies = self._interpret_frames(self._scan.frames, final=final)

    def _scan_packets(self, raw: bytes, *, final: bool) -> ScanResult:
        return self._codec.scan(raw, self._sizes.values(), final=final)

    def _interpret_frames(self, frames: Iterable[StatusPacket], *, final: bool) -> dict[int, Reply]:
        replies: dict[int, Reply] = {}
        for frame in frames:
            size = self._sizes.get(frame.servo_id)
            reply = None if size is None else self._codec.interpret(frame, size)
            if reply is None or (not final and self._may_be_stale(reply)):
                continue
            first = replies.setdefault(frame.servo_id, reply)
            if first is not reply and first != reply:
                replies[frame.servo_id] = self._prefer_data(first, reply)
        return replies

    def _may_be_stale(self, reply: Reply) -> bool:
        """Check whether a refusal may belong to an earlier request."""
        if isinstance(reply, Status) or self._sizes[reply.servo_id] == 0:
            return False
        now_s = self._port.clock.now_s()
        return self._port.pending.pending_until_s((reply.servo_id,), now_s) is not None

    def _prefer_data(self, first: Reply, second: Reply) -> Reply:
        """Return the reply that has data; a fault if both have data, because the two differ."""
        if isinstance(first, ReplyFault):
            return second
        if isinstance(second, ReplyFault):
            return first
        found = "sent two different replies"
        return ReplyFault(first.servo_id, FaultKind.GARBLED, found, sent=self._port.sent)

    def _finish_at_deadline(self) -> dict[int, Reply]:
        """Return the replies and faults once the deadline has passed."""
        self._parse_received(final=True)
        if not self._replies:
            self._update_line_health()
        surplus = len(self._scan.frames) > len(self._replies)
        odd = self._stale or self._older > 0 or self._scan.junk or surplus
        self._port.health.record(odd=bool(odd))
        kind, found = FaultKind.SILENT, "does not answer"
        if self._scan.junk:
            kind, found = FaultKind.GARBLED, "sent a damaged reply"
        sent, received = self._port.sent, bytes(self._raw)
        missing = (servo_id for servo_id in self._sizes if servo_id not in self._replies)
        faults = {i: ReplyFault(i, kind, found, sent=sent, received=received) for i in missing}
        return self._replies | faults

    def _update_line_health(self) -> None:
        """Update timeout and byte rate if no reply arrived; first look for an echo-like reply."""
        port = self._port
        if bytes(self._raw) == port.sent and port.echoes is None and not any(self._sizes.values()):
            # A reply may equal its request: a Feetech ping under a voltage alarm.
            self._scan = self._scan_packets(bytes(self._raw), final=True)
            self._replies = self._interpret_frames(self._scan.frames, final=True)
        if not self._replies:
            if not self._scan.frames and not self._scan.junk:  # invalid bytes came in time
                port.reply_timeout.on_timeout(many=len(self._sizes) > 1)
            if self._stale:
                port.byte_rate.reset()


_NO_REPLIES: Mapping[int, int] = {}


class Transceiver:
    """Sender of requests on a port, and receiver of the replies.

    Attributes:
        return_delay_s: The longest delay of a servo before it replies, as in the servos' registers.
    """

    def __init__(self, port: Port, codec: PacketCodec) -> None:
        self.port, self.codec = port, codec
        self.return_delay_s = MAX_RETURN_DELAY_S

    def choose_window(
        self, servo_ids: tuple[int, ...], span: MemoryRange, size_of: Callable[[int], int] = int
    ) -> MemoryRange:
        """Choose the memory window to read for a span.

        The window is the span itself unless a reply of that length is still pending from one of the
        servos; see ``PendingReplies``. If replies of every length are pending, this method waits.
        """
        port = self.port
        find = port.pending.distinct_window
        found = find(servo_ids, span, port.clock.now_s(), port.health, size_of)
        if found is None:
            self.wait_for_pending(servo_ids)
        return found or span

    def wait_for_pending(self, servo_ids: tuple[int, ...]) -> None:
        """Wait until no earlier reply of these servos can arrive any more."""
        port = self.port
        quiet_s = port.pending.clear_from_s(servo_ids, port.clock.now_s(), port.health)
        port.clock.sleep_until(quiet_s)

    def transact(
        self,
        send: Callable[[], int],
        sizes: Mapping[int, int] = _NO_REPLIES,
        ranges: Mapping[int, MemoryRange] | MemoryRange | None = None,
    ) -> dict[int, Reply]:
        """Send a packet and receive the reply of each servo.

        Args:
            send: Sends the packet through the vendor's SDK; returns its result code.
            sizes: Bytes of data of each reply, by servo id in the order of the replies.
            ranges: The memory to read, for all servos or for each; None for other requests.

        Returns:
            A status or a fault for every id.

        Raises:
            PortLostError: The port is lost.
        """
        port = self.port
        with port.lock:
            try:
                self.send(send)
                if not sizes:
                    return {}
                ambiguous = self._ambiguous_ids(sizes) if ranges is None else ()
                delays_s = len(sizes) * self.return_delay_s
                replies = ReplyReader(port, self.codec, sizes).read_replies(delays_s)
                self._record_replies(replies, sizes, ranges)
            finally:
                port.is_using = False
        for servo_id in ambiguous:
            reply = replies[servo_id]
            if isinstance(reply, Status):
                replies[servo_id] = replace(reply, ambiguous=True)
        return replies

    def send(self, send: Callable[[], int]) -> None:
        """Send without waiting for a reply.

        Raises:
            BusError: The packet is too long.
            PortLostError: The port is lost.
        """
        result = send()
        if result == self.codec.too_long:
            raise BusError(
                "cannot send such a long packet", "Read fewer servos at once.", port=self.port.name
            )
        if result != 0:
            raise PortLostError(self.port.name, "the packet was not sent completely")

    def _ambiguous_ids(self, sizes: Mapping[int, int]) -> list[int]:
        """Return the servos whose replies cannot be distinguished from earlier replies."""
        port, now_s = self.port, self.port.clock.now_s()
        pending, health = port.pending, port.health
        if not health.suspect:
            return [i for i, size in sizes.items() if pending.is_pending(i, size, now_s)]
        return [
            i
            for i, size in sizes.items()
            if pending.is_ambiguous((i,), size, port.sent, now_s, health)
        ]

    def _record_replies(
        self,
        replies: Mapping[int, Reply],
        sizes: Mapping[int, int],
        ranges: Mapping[int, MemoryRange] | MemoryRange | None,
    ) -> None:
        pending, now_s = self.port.pending, self.port.clock.now_s()
        if isinstance(ranges, MemoryRange) and all(
            type(reply) is Status for reply in replies.values()
        ):
            pending.record_received(tuple(sizes), next(iter(sizes.values())), ranges, now_s)
            return
        received: dict[tuple[int, object], list[int]] = {}
        for servo_id, reply in replies.items():
            if isinstance(reply, ReplyFault) and reply.kind is not FaultKind.REFUSED:
                pending.add_pending(servo_id, sizes[servo_id], now_s)
                continue
            what = ranges.get(servo_id) if isinstance(ranges, Mapping) else ranges or self.port.sent
            received.setdefault((sizes[servo_id], what), []).append(servo_id)
        for (size, what), servo_ids in received.items():
            pending.record_received(tuple(servo_ids), size, what, now_s)


_MAX_CACHED = 64  # more packets than a program repeats; a faulty line must not fill the memory
_SHORT_WRITE = 1  # any code but 0; ``send`` raises PortLostError for it

CacheKey = tuple[int, int, bytes]
"""Id, instruction and parameters of a packet."""


class RepeatedPackets:
    """Cache of repeated packets without values, so that the SDK builds each of them only once."""

    def __init__(self, port: Port, cacheable: frozenset[int]) -> None:
        self._port, self._cacheable = port, cacheable
        self._packets: dict[CacheKey, bytes] = {}

    def send(self, key: CacheKey) -> int | None:
        """Clear the input and send a recorded packet; return the result code; None if unknown."""
        packet = self._packets.get(key)
        if packet is None:
            return None
        self._port.clearPort()
        return 0 if self._port.writePort(packet) == len(packet) else _SHORT_WRITE

    def record_sent(self, key: CacheKey, result: int) -> int:
        """Record the packet that the SDK has just sent; return the SDK's result code."""
        if result == 0 and key[1] in self._cacheable:
            if len(self._packets) >= _MAX_CACHED:
                self._packets.clear()
            self._packets[key] = self._port.sent
        return result
