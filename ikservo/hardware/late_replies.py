"""Track which late replies may still arrive, the health of the line, and the reply timeout.

A status packet contains its sender and its length; it does not identify the request that it replies
to. A request that is repeated while the first reply is overdue may therefore receive the first
reply. Waiting 200 ms after each loss is too long. The next request is therefore formed so that its
reply differs in length from every reply that is still pending.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from ikservo.hardware.packets import MemoryRange

# Number of clean requests until the line is trusted.
_AT_FIRST = 50
_PER_EVENT = 300  # added by each anomaly
_MAX_SUSPICION = 3000  # maximum of this number

_LEARNED_CHUNKS = 16  # number of replies not faster than the wire allows, before the check applies
_MARGIN_BYTES = 1.03  # clocks of servos and adapters differ by this much at most


class LineHealth:
    """Health of the line: healthy after enough clean requests, of which each anomaly requires more.

    Args:
        clean_requests: The number of clean requests until the line counts as healthy.

    Attributes:
        suspect: Whether the line is not known to be healthy; static registers are then read twice.
        degraded: Whether an anomaly occurred recently; a repeated request must then have another
            reply length.
    """

    def __init__(self, clean_requests: int = _AT_FIRST) -> None:
        self._clean_requests_left = clean_requests
        self.suspect, self.degraded = clean_requests > 0, False

    def record(self, *, odd: bool) -> None:
        """Count one request and whether an anomaly occurred in its replies."""
        if odd:
            self._clean_requests_left = min(self._clean_requests_left + _PER_EVENT, _MAX_SUSPICION)
            self.suspect = self.degraded = True
        elif self.suspect:
            self._clean_requests_left -= 1
            self.suspect = self._clean_requests_left > 0
            self.degraded = self.degraded and self.suspect


class ByteRateCheck:
    """Count of the reply bytes that can have arrived; any more bytes are older than the request.

    Some lines are faster than their baud rate (a socket, a bridge, a pseudo-terminal). The limit
    therefore applies only after several replies have kept it, until a reply is missed.
    """

    def __init__(self) -> None:
        self._on_time = 0

    def excess_bytes(self, count: int, since_s: float, byte_s: float) -> int:
        """Compute how many of the received bytes are older than a request sent ``since_s`` ago."""
        if self._on_time < _LEARNED_CHUNKS:
            return 0
        return max(0, count - int(since_s / byte_s * _MARGIN_BYTES + 1))

    def on_reply(self, count: int, since_s: float, byte_s: float) -> None:
        """Record whether a complete reply took at least its time on the wire."""
        self._on_time = self._on_time + 1 if count <= since_s / byte_s * _MARGIN_BYTES + 1 else 0

    def reset(self) -> None:
        """Count replies from zero, because bytes were discarded as stale and no reply came."""
        self._on_time = 0


MAX_REPLY_DELAY_S = 0.25
"""Longest delay after which a reply is still expected, seconds."""

# An adapter that delivers a reply twice does so within a few USB frames.
_DUPLICATE_WINDOW_S = 0.020
# Latest requests whose replies may come a second time.
_CLEAN_DUPLICATES = 3  # on a healthy line
_SUSPECT_DUPLICATES = 6  # on any other line
_MAX_WINDOW_BYTES = 64  # most bytes read in addition to the requested ones

_Ids = tuple[int, ...]


@dataclass(slots=True)
class _ReceivedReply:
    """A request with a reply, which may arrive a second time."""

    size: int
    request: object  # None after a write that has made the reply stale
    at_s: float


class PendingReplies:
    """Record of the replies that may still arrive from each servo on one line."""

    def __init__(self) -> None:
        self._pending: dict[int, list[tuple[int, float]]] = {}  # by servo id: size and expiry time
        self._received: dict[_Ids, deque[_ReceivedReply]] = {}
        self._overlapping: dict[_Ids, list[deque[_ReceivedReply]]] = {}

    def add_pending(self, servo_id: int, size: int, now_s: float) -> None:
        """Record that a reply of ``size`` data bytes is overdue."""
        self._pending.setdefault(servo_id, []).append((size, now_s + MAX_REPLY_DELAY_S))

    def record_received(self, servo_ids: _Ids, size: int, request: object, now_s: float) -> None:
        """Record replies, so that a second copy is not taken for another reply."""
        past = self._received.get(servo_ids)
        if past is None:
            past = self._received[servo_ids] = deque(maxlen=_SUSPECT_DUPLICATES)
            self._overlapping.clear()
        for reply in past:
            if reply.size == size and reply.request == request:
                reply.at_s = now_s
                return
        past.append(_ReceivedReply(size, request, now_s))

    def invalidate(self, servo_ids: Iterable[int], written: MemoryRange | None = None) -> None:
        """Mark earlier replies of servos as stale after a write."""
        for past in self._received_of(tuple(servo_ids)):
            for reply in past:
                request = reply.request
                if not written or not isinstance(request, MemoryRange) or written.overlaps(request):
                    reply.request = None

    @property
    def any_pending(self) -> bool:
        """Whether a reply may be overdue; expired entries that are not yet removed also count."""
        return bool(self._pending)

    def pending_until_s(self, servo_ids: _Ids, now_s: float) -> float | None:
        """Return when the last pending reply of servos expires; None if no reply is pending."""
        pending = (entry for servo_id in servo_ids for entry in self._pending_of(servo_id, now_s))
        return max((until_s for _, until_s in pending), default=None)

    def clear_from_s(self, servo_ids: _Ids, now_s: float, health: LineHealth) -> float:
        """Return the time after which no older reply, overdue or duplicated, can arrive."""
        pending_s = self.pending_until_s(servo_ids, now_s) or now_s
        if not health.degraded:
            return pending_s
        received = (reply.at_s for past in self._received_of(servo_ids) for reply in past)
        return max(pending_s, max(received, default=now_s - MAX_REPLY_DELAY_S) + MAX_REPLY_DELAY_S)

    def is_pending(self, servo_id: int, size: int, now_s: float) -> bool:
        """Check whether a reply of this length is pending from a servo."""
        return any(size == pending for pending, _ in self._pending_of(servo_id, now_s))

    def is_ambiguous(
        self, servo_ids: _Ids, size: int, request: object, now_s: float, health: LineHealth
    ) -> bool:
        """Check whether an older reply could be taken for the reply to this request.

        Args:
            servo_ids: The servos that will reply.
            size: Bytes of data in the reply.
            request: The request; a second copy of the reply to the same request does no harm on a
                healthy line.
            now_s: The current time.
            health: The health of the line: on a suspect line replies may be doubled for longer, on
                a degraded line even the same request must have another reply length.
        """
        if self._pending and any(self.is_pending(servo_id, size, now_s) for servo_id in servo_ids):
            return True

        for past in self._received_of(servo_ids):
            confusable = [
                reply
                for reply in past
                if reply.size == size and (health.degraded or reply.request != request)
            ]
            if confusable:  # rare, so the latest replies are searched only now
                latest = _possible_duplicates(past, now_s, suspect=health.suspect)
                if any(reply in confusable for reply in latest):
                    return True
        return False

    def distinct_window(
        self,
        servo_ids: _Ids,
        span: MemoryRange,
        now_s: float,
        health: LineHealth,
        size_of: Callable[[int], int] = int,
    ) -> MemoryRange | None:
        """Return the smallest window around a span whose reply length is not pending.

        Args:
            servo_ids: The servos that will reply.
            span: The required range.
            now_s: The current time.
            health: The health of the line, see ``is_ambiguous``.
            size_of: Returns the number of data bytes in the reply for a window of a given size.

        Returns:
            The window, or None if replies of every length are pending.
        """
        for by in range(_MAX_WINDOW_BYTES + 1):
            wider = span.grown(by) if by else span
            if not self.is_ambiguous(servo_ids, size_of(wider.size), wider, now_s, health):
                return wider
        return None

    def _pending_of(self, servo_id: int, now_s: float) -> list[tuple[int, float]]:
        if servo_id not in self._pending:
            return []
        pending = [entry for entry in self._pending[servo_id] if entry[1] > now_s]
        if pending:
            self._pending[servo_id] = pending
        else:
            del self._pending[servo_id]
        return pending

    def _received_of(self, servo_ids: _Ids) -> list[deque[_ReceivedReply]]:
        """Return the recent requests to which these servos replied."""
        overlapping = self._overlapping.get(servo_ids)
        if overlapping is None:
            members = set(servo_ids)
            overlapping = [
                past for ids, past in self._received.items() if not members.isdisjoint(ids)
            ]
            self._overlapping[servo_ids] = overlapping
        return overlapping


def _possible_duplicates(
    past: deque[_ReceivedReply], now_s: float, *, suspect: bool
) -> Iterator[_ReceivedReply]:
    recent_s, count = (
        (MAX_REPLY_DELAY_S, _SUSPECT_DUPLICATES)
        if suspect
        else (_DUPLICATE_WINDOW_S, _CLEAN_DUPLICATES)
    )
    latest = (
        sorted(past, key=lambda reply: reply.at_s, reverse=True)[:count] if len(past) > 1 else past
    )
    return (reply for reply in latest if now_s - reply.at_s < recent_s)


_LEARNED_REPLIES = 16  # replies before their times are used
_HISTORY_LENGTH = 32  # number of replies among which the slowest is found
_MARGIN = 1.5  # multiple of the slowest recent reply
_MAX_DOUBLINGS = 6
_MAX_OWN_MISSES = 2  # consecutive timeouts that still count as a servo's fault


class AdaptiveTimeout:
    """Timeout for replies that may never come, learned from the delays of past replies.

    USB adapters hold bytes back for 1 to 16 ms, depending on the model, so the timeout starts long
    and shrinks to a multiple of the slowest recent reply. It grows again while no servo replies.
    """

    def __init__(self, min_s: float, max_s: float) -> None:
        self.min_s, self.max_s = min_s, max_s
        self._learned = self._timeouts = 0
        self._slowest_s = self._slowest_before_s = 0.0

    @property
    def typical_s(self) -> float:
        """Maximum recent delay of replies beyond wire time and return delays."""
        if self._learned < _LEARNED_REPLIES:
            return self.max_s
        return min(max(self._slowest_s, self._slowest_before_s), self.max_s)

    @property
    def timeout_s(self) -> float:
        """Time to wait beyond wire time and return delays, seconds."""
        if self._learned < _LEARNED_REPLIES:
            return self.max_s
        learned_s = max(self.min_s, _MARGIN * self.typical_s)
        factor = 2.0 ** min(max(self._timeouts - _MAX_OWN_MISSES, 0), _MAX_DOUBLINGS)
        return min(learned_s * factor, self.max_s)

    def on_reply(self, overhead_s: float) -> None:
        """Record how much longer a reply took than its time on the wire."""
        self._timeouts = 0
        self._learned += 1
        if self._learned % _HISTORY_LENGTH == 0:
            self._slowest_before_s, self._slowest_s = self._slowest_s, overhead_s
        elif overhead_s > self._slowest_s:
            self._slowest_s = overhead_s

    def on_timeout(self, *, many: bool = False) -> None:
        """Double the timeout from the third consecutive time without any reply.

        Args:
            many: Whether several servos were asked for replies; then the adapter or this machine is
                slow, and the timeout is quadrupled at once.
        """
        self._timeouts = max(self._timeouts + 1, _MAX_OWN_MISSES + 2 if many else 0)

    def use_maximum(self) -> None:
        """Use the longest timeout for the next reply, the last retry of a single servo."""
        self._timeouts = _MAX_OWN_MISSES + _MAX_DOUBLINGS
