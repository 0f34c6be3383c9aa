"""Hearing one question's answers out, amid echo, noise and bytes that are older than it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from ikservo.hardware.line.port import Port
from ikservo.hardware.packets.dialect import Dialect, Frame, Heard
from ikservo.hardware.packets.replies import Fault, FaultKind, Reply, Status

__all__ = ["Listening"]

_MOST_WAITS = 10  # times the patience for one answer, as long as bytes keep coming

_NOTHING = Heard((), 0, 0)


class Listening:
    """What has come since the latest question, and what it says.

    Args:
        port: The line; the question has just been sent.
        dialect: How answers are written.
        sizes: Who will answer, in which order, and how many bytes of data each answer carries.
    """

    def __init__(self, port: Port, dialect: Dialect, sizes: Mapping[int, int]) -> None:
        self._port, self._dialect, self._sizes = port, dialect, sizes
        self._expected = sum(map(dialect.frame_size, sizes.values()))
        self._raw, self._stale, self._older = bytearray(), 0, 0
        self._heard: Heard = _NOTHING
        self._answers: dict[int, Reply] = {}

    def replies(self, delays_s: float) -> dict[int, Reply]:
        """Listen until everybody has answered, or nobody can answer any more.

        Args:
            delays_s: How long all of them together may take before they speak, seconds.

        Raises:
            PortLostError: The line is gone.
        """
        port = self._port
        due_s = port.due_s(self._expected, delays_s)
        if port.is_calm:
            port.nap(self._expected)
        chunk = port.read_until(self._expected, due_s + port.patience.usual_s)
        answers = self._in_order(chunk)
        return self._heard_on(chunk, due_s) if answers is None else answers

    def _in_order(self, chunk: bytes) -> dict[int, Reply] | None:
        """Return the answers where nothing else came, as is the rule."""
        port = self._port
        if len(chunk) != self._expected or port.echoes is not False or port.stale_bytes(len(chunk)):
            return None
        answers = self._dialect.in_order(chunk, self._sizes)
        if answers is not None:
            port.learn(chunk, answered=self._expected)
            port.trust.note(odd=False)
        return answers

    def _heard_on(self, chunk: bytes, due_s: float) -> dict[int, Reply]:
        """Go on until all is said, or nothing more can come of what is missing."""
        port, patience_s = self._port, self._port.patience.allowance_s
        deadline_s, limit_s = due_s + patience_s, due_s + (1 + _MOST_WAITS) * patience_s
        while True:
            speaking = bool(chunk) and self._take(chunk)
            self._understand(final=False)
            if len(self._answers) == len(self._sizes):
                return self._complete()
            now_s = port.clock.now_s()
            if self._last_has_spoken():
                deadline_s = due_s
            elif speaking and (now_s < deadline_s or len(self._sizes) > 1):
                deadline_s = min(max(deadline_s, now_s + patience_s), limit_s)
            if now_s >= deadline_s:
                return self._overdue()
            chunk = port.read_some(self._missing(), deadline_s)

    def _missing(self) -> int:
        """Return how many bytes must come at least; one more look if none must."""
        frame_size = self._dialect.frame_size
        there = sum(frame_size(self._sizes[i]) for i in self._answers) + self._heard.pending
        return max(self._expected - there, 1)

    def _take(self, chunk: bytes) -> bool:
        """Add what came; return whether it is young enough to be an answer."""
        self._raw += chunk
        early = self._port.stale_bytes(len(self._raw) + self._stale) - self._stale
        if early > 0:
            del self._raw[:early]
            self._stale += early
        return early <= 0

    def _last_has_spoken(self) -> bool:
        """Return whether everybody has had a turn, so that no patience brings a silent one."""
        last, now_s = next(reversed(self._sizes)), self._port.clock.now_s()
        return last in self._answers and not self._port.ghosts.owed_until_s((last,), now_s)

    def _understand(self, *, final: bool) -> None:
        """Find frames and answers in all that was heard, behind our own echo (F12)."""
        raw = bytes(self._raw)
        if self._port.echoes is not False:
            raw = self._behind_echo(raw, final=final)
        self._heard = self._scan(raw, final=final) if raw else _NOTHING
        self._answers = self._found(self._heard.frames, final=final)

    def _behind_echo(self, raw: bytes, *, final: bool) -> bytes:
        """Return what came after our own bytes; whatever stands before them is older."""
        sent = self._port.sent
        # A ping may be answered by its very own bytes.
        anywhere = self._port.echoes or any(self._sizes.values())
        self._older = raw.find(sent) if anywhere else raw.startswith(sent) - 1
        if self._older >= 0:
            return raw[self._older + len(sent) :]
        return b"" if not final and sent.startswith(raw) else raw

    def _scan(self, raw: bytes, *, final: bool) -> Heard:
        return self._dialect.scan(raw, self._sizes.values(), final=final)

    def _found(self, frames: Iterable[Frame], *, final: bool) -> dict[int, Reply]:
        answers: dict[int, Reply] = {}
        for frame in frames:
            size = self._sizes.get(frame.servo_id)
            reply = None if size is None else self._dialect.judge(frame, size)
            if reply is None or (not final and self._may_be_older(reply)):
                continue
            first = answers.setdefault(frame.servo_id, reply)
            if first is not reply and first != reply:
                answers[frame.servo_id] = self._better(first, reply)
        return answers

    def _may_be_older(self, reply: Reply) -> bool:
        """Return whether a refusal may refuse an earlier question, so that we listen on."""
        if isinstance(reply, Status) or self._sizes[reply.servo_id] == 0:
            return False
        now_s = self._port.clock.now_s()
        return self._port.ghosts.owed_until_s((reply.servo_id,), now_s) is not None

    def _better(self, first: Reply, second: Reply) -> Reply:
        """Return the answer with data beside a refusal; of two with data that differ, neither."""
        if isinstance(first, Fault):
            return second
        if isinstance(second, Fault):
            return first
        found = "sent two different replies"
        return Fault(first.servo_id, FaultKind.GARBLED, found, sent=self._port.sent)

    def _complete(self) -> dict[int, Reply]:
        self._port.learn(self._raw, answered=self._expected)
        surplus = len(self._heard.frames) > len(self._sizes)
        odd = self._stale or self._older > 0 or self._heard.junk or surplus
        self._port.trust.note(odd=bool(odd))
        return self._answers

    def _overdue(self) -> dict[int, Reply]:
        """Make the best of what was heard once the deadline has passed."""
        self._understand(final=True)
        if not self._answers:
            self._consider_silence()
        surplus = len(self._heard.frames) > len(self._answers)
        odd = self._stale or self._older > 0 or self._heard.junk or surplus
        self._port.trust.note(odd=bool(odd))
        absent = (servo_id for servo_id in self._sizes if servo_id not in self._answers)
        return self._answers | {servo_id: self._fault(servo_id) for servo_id in absent}

    def _consider_silence(self) -> None:
        """Look once more at what seemed to be nothing, before nothing is made of it."""
        port = self._port
        if bytes(self._raw) == port.sent and port.echoes is None and not any(self._sizes.values()):
            # An answer that is byte for byte its question: a Feetech ping under a voltage alarm.
            self._heard = self._scan(bytes(self._raw), final=True)
            self._answers = self._found(self._heard.frames, final=True)
        if not self._answers:
            if not self._heard.frames and not self._heard.junk:  # a part would have come as fast
                port.patience.miss(many=len(self._sizes) > 1)
            if self._stale:
                port.pace.mistrust()

    def _fault(self, servo_id: int) -> Fault:
        junk = self._heard.junk
        kind = FaultKind.GARBLED if junk else FaultKind.SILENT
        found = "sent a damaged reply" if junk else "does not answer"
        return Fault(servo_id, kind, found, sent=self._port.sent, received=bytes(self._raw))
