"""One instruction out, its status packets back: reply window, retries, resynchronisation."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

from ikservo.errors import BusError, PortLostError
from ikservo.hardware.packets import (
    LONGEST_RETURN_DELAY_S,
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

__all__ = ["PacketCache", "ReplyReader", "Transceiver"]


_MAX_WAITS = 10  # times the patience for one answer, as long as bytes keep coming

_NOTHING = ScanResult((), 0, 0)


class ReplyReader:
    """What has come since the latest question, and what it says.

    Args:
        port: The line; the question has just been sent.
        dialect: How answers are written.
        sizes: Who will answer, in which order, and how many bytes of data each answer carries.
    """

    def __init__(self, port: Port, dialect: PacketCodec, sizes: Mapping[int, int]) -> None:
        self._port, self._dialect, self._sizes = port, dialect, sizes
        self._expected = sum(map(dialect.frame_size, sizes.values()))
        self._raw, self._stale, self._older = bytearray(), 0, 0
        self._heard: ScanResult = _NOTHING
        self._answers: dict[int, Reply] = {}

    def read_replies(self, delays_s: float) -> dict[int, Reply]:
        """Listen until everybody has answered, or nobody can answer any more.

        Args:
            delays_s: How long all of them together may take before they speak, seconds.

        Raises:
            PortLostError: The line is gone.
        """
        port = self._port
        due_s = port.expected_at_s(self._expected, delays_s)
        if port.is_clean:
            port.sleep_until_due(self._expected)
        chunk = port.read_until(self._expected, due_s + port.patience.typical_s)
        answers = self._parse_in_order(chunk)
        return self._read_remaining(chunk, due_s) if answers is None else answers

    def _parse_in_order(self, chunk: bytes) -> dict[int, Reply] | None:
        """Return the answers where nothing else came, as is the rule."""
        port = self._port
        if len(chunk) != self._expected or port.echoes is not False or port.stale_bytes(len(chunk)):
            return None
        answers = self._dialect.parse_in_order(chunk, self._sizes)
        if answers is not None:
            port.on_reply(chunk, answered=self._expected)
            port.trust.record(odd=False)
        return answers

    def _read_remaining(self, chunk: bytes, due_s: float) -> dict[int, Reply]:
        """Go on until all is said, or nothing more can come of what is missing."""
        port, patience_s = self._port, self._port.patience.timeout_s
        deadline_s, limit_s = due_s + patience_s, due_s + (1 + _MAX_WAITS) * patience_s
        while True:
            speaking = bool(chunk) and self._add_chunk(chunk)
            self._parse_received(final=False)
            if len(self._answers) == len(self._sizes):
                return self._finish_complete()
            now_s = port.clock.now_s()
            if self._all_turns_passed():
                deadline_s = due_s
            elif speaking and (now_s < deadline_s or len(self._sizes) > 1):
                deadline_s = min(max(deadline_s, now_s + patience_s), limit_s)
            if now_s >= deadline_s:
                return self._finish_at_deadline()
            chunk = port.read_some(self._missing_bytes(), deadline_s)

    def _missing_bytes(self) -> int:
        """Return how many bytes must come at least; one more look if none must."""
        frame_size = self._dialect.frame_size
        there = sum(frame_size(self._sizes[i]) for i in self._answers) + self._heard.pending
        return max(self._expected - there, 1)

    def _add_chunk(self, chunk: bytes) -> bool:
        """Add what came; return whether it is young enough to be an answer."""
        self._raw += chunk
        early = self._port.stale_bytes(len(self._raw) + self._stale) - self._stale
        if early > 0:
            del self._raw[:early]
            self._stale += early
        return early <= 0

    def _all_turns_passed(self) -> bool:
        """Return whether everybody has had a turn, so that no patience brings a silent one."""
        last, now_s = next(reversed(self._sizes)), self._port.clock.now_s()
        return last in self._answers and not self._port.ghosts.pending_until_s((last,), now_s)

    def _parse_received(self, *, final: bool) -> None:
        """Find frames and answers in all that was heard, behind our own echo (F12)."""
        raw = bytes(self._raw)
        if self._port.echoes is not False:
            raw = self._strip_echo(raw, final=final)
        self._heard = self._scan_packets(raw, final=final) if raw else _NOTHING
        self._answers = self._interpret_frames(self._heard.frames, final=final)

    def _strip_echo(self, raw: bytes, *, final: bool) -> bytes:
        """Return what came after our own bytes; whatever stands before them is older."""
        sent = self._port.sent
        # A ping may be answered by its very own bytes.
        anywhere = self._port.echoes or any(self._sizes.values())
        self._older = raw.find(sent) if anywhere else raw.startswith(sent) - 1
        if self._older >= 0:
            return raw[self._older + len(sent) :]
        return b"" if not final and sent.startswith(raw) else raw

    def _scan_packets(self, raw: bytes, *, final: bool) -> ScanResult:
        return self._dialect.scan(raw, self._sizes.values(), final=final)

    def _interpret_frames(self, frames: Iterable[StatusPacket], *, final: bool) -> dict[int, Reply]:
        answers: dict[int, Reply] = {}
        for frame in frames:
            size = self._sizes.get(frame.servo_id)
            reply = None if size is None else self._dialect.interpret(frame, size)
            if reply is None or (not final and self._may_be_stale(reply)):
                continue
            first = answers.setdefault(frame.servo_id, reply)
            if first is not reply and first != reply:
                answers[frame.servo_id] = self._prefer_data(first, reply)
        return answers

    def _may_be_stale(self, reply: Reply) -> bool:
        """Return whether a refusal may refuse an earlier question, so that we listen on."""
        if isinstance(reply, Status) or self._sizes[reply.servo_id] == 0:
            return False
        now_s = self._port.clock.now_s()
        return self._port.ghosts.pending_until_s((reply.servo_id,), now_s) is not None

    def _prefer_data(self, first: Reply, second: Reply) -> Reply:
        """Return the answer with data beside a refusal; of two with data that differ, neither."""
        if isinstance(first, ReplyFault):
            return second
        if isinstance(second, ReplyFault):
            return first
        found = "sent two different replies"
        return ReplyFault(first.servo_id, FaultKind.GARBLED, found, sent=self._port.sent)

    def _finish_complete(self) -> dict[int, Reply]:
        self._port.on_reply(self._raw, answered=self._expected)
        surplus = len(self._heard.frames) > len(self._sizes)
        odd = self._stale or self._older > 0 or self._heard.junk or surplus
        self._port.trust.record(odd=bool(odd))
        return self._answers

    def _finish_at_deadline(self) -> dict[int, Reply]:
        """Make the best of what was heard once the deadline has passed."""
        self._parse_received(final=True)
        if not self._answers:
            self._update_line_health()
        surplus = len(self._heard.frames) > len(self._answers)
        odd = self._stale or self._older > 0 or self._heard.junk or surplus
        self._port.trust.record(odd=bool(odd))
        absent = (servo_id for servo_id in self._sizes if servo_id not in self._answers)
        return self._answers | {servo_id: self._fault_of(servo_id) for servo_id in absent}

    def _update_line_health(self) -> None:
        """Look once more at what seemed to be nothing, before nothing is made of it."""
        port = self._port
        if bytes(self._raw) == port.sent and port.echoes is None and not any(self._sizes.values()):
            # An answer that is byte for byte its question: a Feetech ping under a voltage alarm.
            self._heard = self._scan_packets(bytes(self._raw), final=True)
            self._answers = self._interpret_frames(self._heard.frames, final=True)
        if not self._answers:
            if not self._heard.frames and not self._heard.junk:  # a part would have come as fast
                port.patience.on_timeout(many=len(self._sizes) > 1)
            if self._stale:
                port.pace.reset()

    def _fault_of(self, servo_id: int) -> ReplyFault:
        junk = self._heard.junk
        kind = FaultKind.GARBLED if junk else FaultKind.SILENT
        found = "sent a damaged reply" if junk else "does not answer"
        return ReplyFault(servo_id, kind, found, sent=self._port.sent, received=bytes(self._raw))


_NOBODY: Mapping[int, int] = {}


class Transceiver:
    """Puts questions on a port and hears the answers out.

    Attributes:
        port: The line.
        dialect: How answers are written.
    """

    def __init__(self, port: Port, dialect: PacketCodec) -> None:
        self.port, self.dialect = port, dialect
        self._return_delay_s = LONGEST_RETURN_DELAY_S

    @property
    def return_delay_s(self) -> float:
        """Return the longest a servo waits before it answers, seconds."""
        return self._return_delay_s

    def set_return_delay(self, return_delay_s: float) -> None:
        """Wait no longer than this before each answer, seconds: what the servos' registers say."""
        self._return_delay_s = return_delay_s

    def choose_window(
        self, servo_ids: tuple[int, ...], span: MemoryRange, size_of: Callable[[int], int] = int
    ) -> MemoryRange:
        """Return the window through which a span is best read now.

        It is the span itself unless an answer of that length is still owed by one of the servos;
        see ``PendingReplies``. If answers of every length are owed, time passes until none is.
        """
        port = self.port
        find = port.ghosts.distinct_window
        found = find(servo_ids, span, port.clock.now_s(), port.trust, size_of)
        if found is None:
            self.wait_for_pending(servo_ids)
        return found or span

    def wait_for_pending(self, servo_ids: tuple[int, ...]) -> None:
        """Let time pass until no older answer of these servos can come any more."""
        port = self.port
        quiet_s = port.ghosts.clear_from_s(servo_ids, port.clock.now_s(), port.trust)
        port.clock.sleep_until(quiet_s)

    def transact(
        self,
        send: Callable[[], int],
        sizes: Mapping[int, int] = _NOBODY,
        asked: Mapping[int, MemoryRange] | MemoryRange | None = None,
    ) -> dict[int, Reply]:
        """Send a packet, then hear each servo out.

        Args:
            send: Puts the packet on the line through the vendor's SDK; returns its result code.
            sizes: Who will answer, and how many bytes of data each answer carries.
            asked: What memory is read, of all servos or of each; None for other questions.

        Returns:
            A status or a fault for every id.

        Raises:
            PortLostError: The line is gone.
        """
        port = self.port
        with port.lock:
            try:
                self.send(send)
                return self._receive_replies(sizes, asked) if sizes else {}
            finally:
                port.is_using = False

    def send(self, send: Callable[[], int]) -> None:
        """Put a packet on the line and nothing more.

        Raises:
            BusError: It is too long.
            PortLostError: The line is gone.
        """
        result = send()
        if result == self.dialect.too_long:
            raise BusError(
                "cannot send so long a packet", "Read fewer servos at once.", port=self.port.name
            )
        if result != 0:
            raise PortLostError(self.port.name, "the packet was not sent completely")

    def _receive_replies(
        self, sizes: Mapping[int, int], asked: Mapping[int, MemoryRange] | MemoryRange | None
    ) -> dict[int, Reply]:
        doubtful = self._ambiguous_ids(sizes) if asked is None else ()
        delays_s = len(sizes) * self.return_delay_s
        replies = ReplyReader(self.port, self.dialect, sizes).read_replies(delays_s)
        self._record_replies(replies, sizes, asked)
        for servo_id in doubtful:
            reply = replies[servo_id]
            if isinstance(reply, Status):
                replies[servo_id] = replace(reply, doubtful=True)
        return replies

    def _ambiguous_ids(self, sizes: Mapping[int, int]) -> list[int]:
        """Return whose answers to what was just sent cannot be told from older ones."""
        port, now_s = self.port, self.port.clock.now_s()
        ghosts, trust = port.ghosts, port.trust
        if not trust.suspect:
            return [i for i, size in sizes.items() if ghosts.is_pending(i, size, now_s)]
        return [
            i
            for i, size in sizes.items()
            if ghosts.is_ambiguous((i,), size, port.sent, now_s, trust)
        ]

    def _record_replies(
        self,
        replies: Mapping[int, Reply],
        sizes: Mapping[int, int],
        asked: Mapping[int, MemoryRange] | MemoryRange | None,
    ) -> None:
        ghosts, now_s = self.port.ghosts, self.port.clock.now_s()
        if isinstance(asked, MemoryRange) and all(
            type(reply) is Status for reply in replies.values()
        ):
            ghosts.record_received(tuple(sizes), next(iter(sizes.values())), asked, now_s)
            return
        answered: dict[tuple[int, object], list[int]] = {}
        for servo_id, reply in replies.items():
            if isinstance(reply, ReplyFault) and reply.kind is not FaultKind.REFUSED:
                ghosts.add_pending(servo_id, sizes[servo_id], now_s)
                continue
            what = asked.get(servo_id) if isinstance(asked, Mapping) else asked or self.port.sent
            answered.setdefault((sizes[servo_id], what), []).append(servo_id)
        for (size, what), servo_ids in answered.items():
            ghosts.record_received(tuple(servo_ids), size, what, now_s)


_MAX_CACHED = 64  # more than a program repeats; a line with troubles must not fill memory
_SHORT_WRITE = 1  # any code but 0; the exchange makes a lost line of it

CacheKey = tuple[int, int, bytes]
"""Id, instruction, parameters."""


class PacketCache:
    """Sends packets; the SDK writes those that carry values anew, and others the first time only.

    Args:
        port: The line.
        write: Hands a phrase to the vendor's ``txPacket``; returns its result code.
        questions: The instructions whose packets carry no values.
    """

    def __init__(
        self, port: Port, write: Callable[[int, int, bytes], int], questions: frozenset[int]
    ) -> None:
        self._port, self._write, self._questions = port, write, questions
        self._packets: dict[CacheKey, bytes] = {}

    def send(self, servo_id: int, instruction: int, parameters: bytes) -> int:
        """Put a packet on the line behind a cleared input; return the SDK's result code."""
        phrase = (servo_id, instruction, parameters)
        packet = self._packets.get(phrase)
        if packet:
            return self._resend_cached(packet)
        result = self._write(servo_id, instruction, parameters)
        if result == 0 and instruction in self._questions:
            self._cache_packet(phrase)
        return result

    def _resend_cached(self, packet: bytes) -> int:
        self._port.clearPort()
        return 0 if self._port.writePort(packet) == len(packet) else _SHORT_WRITE

    def _cache_packet(self, phrase: CacheKey) -> None:
        if len(self._packets) >= _MAX_CACHED:
            self._packets.clear()
        self._packets[phrase] = self._port.sent
