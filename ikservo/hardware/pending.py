"""Pending replies, line health and adaptive timeout: which late bytes may still arrive.

A status packet says who speaks and how many bytes follow; it does not say which question it
answers. Whoever asks again while an answer is overdue may therefore hear the old answer to the
new question. Nobody can wait 200 ms after each loss, but a question can be put so that its
answer has another length than every answer that is still owed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from ikservo.hardware.packets import MemoryRange

__all__ = ["MAX_REPLY_DELAY_S", "AdaptiveTimeout", "ByteRateCheck", "LineHealth", "PendingReplies"]


_AT_FIRST, _PER_EVENT, _MAX_SUSPICION = (
    50,
    300,
    3000,
)  # clean questions that it takes to be believed

_LEARNED_CHUNKS = 16  # answers that came no sooner than the wire allows
_MARGIN_BYTES = 1.03  # clocks of servos and adapters differ by this much at most


class LineHealth:
    """A line is believed once it has been clean for a while; anything odd costs it that.

    Args:
        doubts: How many clean questions it takes until the line is believed.

    Attributes:
        suspect: The line is not believed yet, or not any more: what does not change by itself is
            read twice.
        degraded: Something odd came of late: besides, nothing is asked twice in the same shape.
    """

    def __init__(self, doubts: int = _AT_FIRST) -> None:
        self._doubts = doubts
        self.suspect, self.degraded = doubts > 0, False

    def record(self, *, odd: bool) -> None:
        """Count one question: whether something came that should not have."""
        if odd:
            self._doubts = min(self._doubts + _PER_EVENT, _MAX_SUSPICION)
            self.suspect = self.degraded = True
        elif self.suspect:
            self._doubts -= 1
            self.suspect = self._doubts > 0
            self.degraded = self.degraded and self.suspect


class ByteRateCheck:
    """Knows how many bytes of an answer can have come so far; any more are older than the question.

    Some lines are faster than their baud rate says (a socket, a bridge, a pseudo-terminal), so
    the limit counts only once answers have kept to it for a while, and no longer when keeping to
    it has cost an answer.
    """

    def __init__(self) -> None:
        self._kept = 0

    def excess_bytes(self, count: int, since_s: float, byte_s: float) -> int:
        """Return how many of the bytes heard are older than the question.

        Args:
            count: Bytes heard.
            since_s: Time since the question's last byte left.
            byte_s: Time of a byte on the wire.
        """
        if self._kept < _LEARNED_CHUNKS:
            return 0
        return max(0, count - int(since_s / byte_s * _MARGIN_BYTES + 1))

    def on_reply(self, count: int, since_s: float, byte_s: float) -> None:
        """Remember whether a whole answer came no sooner than it could."""
        self._kept = self._kept + 1 if count <= since_s / byte_s * _MARGIN_BYTES + 1 else 0

    def reset(self) -> None:
        """Forget everything: bytes were called stale and then no answer came."""
        self._kept = 0


MAX_REPLY_DELAY_S = 0.25
"""An answer that is later than this is not expected any more, seconds."""

_DUPLICATE_WINDOW_S = (
    0.020  # an adapter that delivers an answer twice does so within a few USB frames
)
_CLEAN_DUPLICATES, _SUSPECT_DUPLICATES = (
    3,
    6,
)  # latest questions whose answers may come a second time
_MAX_WINDOW_BYTES = 64  # bytes more than were asked for

_Ids = tuple[int, ...]


@dataclass(slots=True)
class _ReceivedReply:
    """A question that was answered; the answer may have a twin."""

    size: int
    asked: object  # None once a write has made the answer untrue
    at_s: float


class PendingReplies:
    """Remembers what may still come from each servo on one line."""

    def __init__(self) -> None:
        self._owed: dict[int, list[tuple[int, float]]] = {}  # size, until when
        self._answered: dict[_Ids, deque[_ReceivedReply]] = {}
        self._kin: dict[_Ids, list[deque[_ReceivedReply]]] = {}

    def add_pending(self, servo_id: int, size: int, now_s: float) -> None:
        """Remember that an answer of ``size`` data bytes is overdue."""
        self._owed.setdefault(servo_id, []).append((size, now_s + MAX_REPLY_DELAY_S))

    def record_received(self, servo_ids: _Ids, size: int, asked: object, now_s: float) -> None:
        """Remember that servos answered, so that a second copy is not taken for something else."""
        past = self._answered.get(servo_ids)
        if past is None:
            past = self._answered[servo_ids] = deque(maxlen=_SUSPECT_DUPLICATES)
            self._kin.clear()
        for question in past:
            if question.size == size and question.asked == asked:
                question.at_s = now_s
                return
        past.append(_ReceivedReply(size, asked, now_s))

    def invalidate(self, servo_ids: Iterable[int], written: MemoryRange | None = None) -> None:
        """Remember that what servos said before a write is no longer true."""
        for past in self._received_of(tuple(servo_ids)):
            for question in past:
                asked = question.asked
                if not written or not isinstance(asked, MemoryRange) or written.overlaps(asked):
                    question.asked = None

    @property
    def any_pending(self) -> bool:
        """Whether an answer may be overdue; some that cannot come any more count, too."""
        return bool(self._owed)

    def pending_until_s(self, servo_ids: _Ids, now_s: float) -> float | None:
        """Return when nothing is owed any more by any of them, None if nothing is."""
        owed = (entry for servo_id in servo_ids for entry in self._pending_of(servo_id, now_s))
        return max((until_s for _, until_s in owed), default=None)

    def clear_from_s(self, servo_ids: _Ids, now_s: float, trust: LineHealth) -> float:
        """Return when no older answer can come any more, neither overdue nor doubled."""
        owed_s = self.pending_until_s(servo_ids, now_s) or now_s
        if not trust.degraded:
            return owed_s
        answered = (question.at_s for past in self._received_of(servo_ids) for question in past)
        return max(owed_s, max(answered, default=now_s - MAX_REPLY_DELAY_S) + MAX_REPLY_DELAY_S)

    def is_pending(self, servo_id: int, size: int, now_s: float) -> bool:
        """Return whether an answer of this length is owed by a servo."""
        return any(size == owed for owed, _ in self._pending_of(servo_id, now_s))

    def is_ambiguous(
        self, servo_ids: _Ids, size: int, asked: object, now_s: float, trust: LineHealth
    ) -> bool:
        """Return whether an older answer could pass for the answer to this question.

        Args:
            servo_ids: Who is asked.
            size: Bytes of data in the answer.
            asked: What is asked; the twin of an answer to the very same question does no harm on
                a healthy line.
            now_s: The present.
            trust: How far the line is believed: on a wary line answers may be doubled for longer,
                on a sick line not even the very same question is put in the same shape.
        """
        if self._owed and any(self.is_pending(servo_id, size, now_s) for servo_id in servo_ids):
            return True
        for past in self._received_of(servo_ids):
            for question in _possible_duplicates(past, now_s, wary=trust.suspect):
                if question.size == size and (trust.degraded or question.asked != asked):
                    return True
        return False

    def distinct_window(
        self,
        servo_ids: _Ids,
        span: MemoryRange,
        now_s: float,
        trust: LineHealth,
        size_of: Callable[[int], int] = int,
    ) -> MemoryRange | None:
        """Return the narrowest window around a span whose answer is like none that may come.

        Args:
            servo_ids: Who is asked.
            span: What is wanted.
            now_s: The present.
            trust: As in ``is_ambiguous``.
            size_of: Data bytes of the answer to a window of so many bytes.

        Returns:
            The window, or None if answers of every length are owed.
        """
        for by in range(_MAX_WINDOW_BYTES + 1):
            wider = span.grown(by) if by else span
            if not self.is_ambiguous(servo_ids, size_of(wider.size), wider, now_s, trust):
                return wider
        return None

    def _pending_of(self, servo_id: int, now_s: float) -> list[tuple[int, float]]:
        if servo_id not in self._owed:
            return []
        owed = [entry for entry in self._owed[servo_id] if entry[1] > now_s]
        if owed:
            self._owed[servo_id] = owed
        else:
            del self._owed[servo_id]
        return owed

    def _received_of(self, servo_ids: _Ids) -> list[deque[_ReceivedReply]]:
        """Return what was asked of these servos, alone or in company."""
        kin = self._kin.get(servo_ids)
        if kin is None:
            members = set(servo_ids)
            kin = [past for ids, past in self._answered.items() if not members.isdisjoint(ids)]
            self._kin[servo_ids] = kin
        return kin


def _possible_duplicates(
    past: deque[_ReceivedReply], now_s: float, *, wary: bool
) -> Iterator[_ReceivedReply]:
    recent_s, most = (
        (MAX_REPLY_DELAY_S, _SUSPECT_DUPLICATES)
        if wary
        else (_DUPLICATE_WINDOW_S, _CLEAN_DUPLICATES)
    )
    latest = sorted(past, key=_request_time_s, reverse=True)[:most] if len(past) > 1 else past
    return (question for question in latest if now_s - question.at_s < recent_s)


def _request_time_s(question: _ReceivedReply) -> float:
    return question.at_s


_LEARNED_REPLIES = 16  # answers before their times are trusted
_HISTORY_LENGTH = 32  # answers of late, and as many before them, whose slowest counts
_MARGIN = 1.5  # times the slowest answer of late
_MAX_DOUBLINGS = 6
_MAX_OWN_MISSES = 2  # silences in a row that are rather a servo's than the adapter's


class AdaptiveTimeout:
    """Learns from the answers that came how long to wait for one that may not come.

    USB adapters hold bytes back for 1 to 16 ms and every one differs, so the wait starts long
    and shrinks to a multiple of the slowest recent answer. It grows again while nobody answers.
    """

    def __init__(self, least_s: float, most_s: float) -> None:
        self.least_s, self.most_s = least_s, most_s
        self._learned = self._silences = 0
        self._slowest_s = self._slowest_before_s = 0.0

    @property
    def typical_s(self) -> float:
        """Return within what time beyond wire time and return delays answers came of late."""
        if self._learned < _LEARNED_REPLIES:
            return self.most_s
        return min(max(self._slowest_s, self._slowest_before_s), self.most_s)

    @property
    def timeout_s(self) -> float:
        """Return how long to wait beyond wire time and return delays, seconds."""
        if self._learned < _LEARNED_REPLIES:
            return self.most_s
        learned_s = max(self.least_s, _MARGIN * self.typical_s)
        factor = 2.0 ** min(max(self._silences - _MAX_OWN_MISSES, 0), _MAX_DOUBLINGS)
        return min(learned_s * factor, self.most_s)

    def on_reply(self, overhead_s: float) -> None:
        """Remember by how much an answer exceeded its time on the wire."""
        self._silences = 0
        self._learned += 1
        if self._learned % _HISTORY_LENGTH == 0:
            self._slowest_before_s, self._slowest_s = self._slowest_s, overhead_s
        elif overhead_s > self._slowest_s:
            self._slowest_s = overhead_s

    def on_timeout(self, *, many: bool = False) -> None:
        """Wait twice as long, from the third time in a row on which nobody answers at all.

        Args:
            many: Several were asked: that is the adapter, or this machine, and four times as
                long is waited at once.
        """
        self._silences = max(self._silences + 1, _MAX_OWN_MISSES + 2 if many else 0)

    def use_longest(self) -> None:
        """Wait for the next answer as long as for any: who is asked alone has earned it."""
        self._silences = _MAX_OWN_MISSES + _MAX_DOUBLINGS
