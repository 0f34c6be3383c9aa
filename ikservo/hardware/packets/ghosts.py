"""Answers that may still be on their way, and questions that none of them can pass for.

A status packet says who speaks and how many bytes follow; it does not say which question it
answers. Whoever asks again while an answer is overdue may therefore hear the old answer to the
new question. Nobody can wait 200 ms after each loss, but a question can be put so that its
answer has another length than every answer that is still owed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from ikservo.hardware.packets.span import Span
from ikservo.hardware.packets.trust import Trust

__all__ = ["LATEST_S", "Ghosts"]

LATEST_S = 0.25
"""An answer that is later than this is not expected any more, seconds."""

_TWIN_S = 0.020  # an adapter that delivers an answer twice does so within a few USB frames
_HEALTHY_TWINS, _WARY_TWINS = 3, 6  # latest questions whose answers may come a second time
_WIDEST = 64  # bytes more than were asked for

_Ids = tuple[int, ...]


@dataclass(slots=True)
class _Answered:
    """A question that was answered; the answer may have a twin."""

    size: int
    asked: object  # None once a write has made the answer untrue
    at_s: float


class Ghosts:
    """Remembers what may still come from each servo on one line."""

    def __init__(self) -> None:
        self._owed: dict[int, list[tuple[int, float]]] = {}  # size, until when
        self._answered: dict[_Ids, deque[_Answered]] = {}
        self._kin: dict[_Ids, list[deque[_Answered]]] = {}

    def owes(self, servo_id: int, size: int, now_s: float) -> None:
        """Remember that an answer of ``size`` data bytes is overdue."""
        self._owed.setdefault(servo_id, []).append((size, now_s + LATEST_S))

    def answered(self, servo_ids: _Ids, size: int, asked: object, now_s: float) -> None:
        """Remember that servos answered, so that a second copy is not taken for something else."""
        past = self._answered.get(servo_ids)
        if past is None:
            past = self._answered[servo_ids] = deque(maxlen=_WARY_TWINS)
            self._kin.clear()
        for question in past:
            if question.size == size and question.asked == asked:
                question.at_s = now_s
                return
        past.append(_Answered(size, asked, now_s))

    def outdate(self, servo_ids: Iterable[int], written: Span | None = None) -> None:
        """Remember that what servos said before a write is no longer true."""
        for past in self._related(tuple(servo_ids)):
            for question in past:
                asked = question.asked
                if not written or not isinstance(asked, Span) or written.meets(asked):
                    question.asked = None

    @property
    def any_owed(self) -> bool:
        """Whether an answer may be overdue; some that cannot come any more count, too."""
        return bool(self._owed)

    def owed_until_s(self, servo_ids: _Ids, now_s: float) -> float | None:
        """Return when nothing is owed any more by any of them, None if nothing is."""
        owed = (entry for servo_id in servo_ids for entry in self._still_owed(servo_id, now_s))
        return max((until_s for _, until_s in owed), default=None)

    def quiet_from_s(self, servo_ids: _Ids, now_s: float, trust: Trust) -> float:
        """Return when no older answer can come any more, neither overdue nor doubled."""
        owed_s = self.owed_until_s(servo_ids, now_s) or now_s
        if not trust.sick:
            return owed_s
        answered = (question.at_s for past in self._related(servo_ids) for question in past)
        return max(owed_s, max(answered, default=now_s - LATEST_S) + LATEST_S)

    def owed(self, servo_id: int, size: int, now_s: float) -> bool:
        """Return whether an answer of this length is owed by a servo."""
        return any(size == owed for owed, _ in self._still_owed(servo_id, now_s))

    def clash(self, servo_ids: _Ids, size: int, asked: object, now_s: float, trust: Trust) -> bool:
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
        if self._owed and any(self.owed(servo_id, size, now_s) for servo_id in servo_ids):
            return True
        for past in self._related(servo_ids):
            for question in _possible_twins(past, now_s, wary=trust.wary):
                if question.size == size and (trust.sick or question.asked != asked):
                    return True
        return False

    def window(
        self,
        servo_ids: _Ids,
        span: Span,
        now_s: float,
        trust: Trust,
        size_of: Callable[[int], int] = int,
    ) -> Span | None:
        """Return the narrowest window around a span whose answer is like none that may come.

        Args:
            servo_ids: Who is asked.
            span: What is wanted.
            now_s: The present.
            trust: As in ``clash``.
            size_of: Data bytes of the answer to a window of so many bytes.

        Returns:
            The window, or None if answers of every length are owed.
        """
        for by in range(_WIDEST + 1):
            wider = span.widened(by) if by else span
            if not self.clash(servo_ids, size_of(wider.size), wider, now_s, trust):
                return wider
        return None

    def _still_owed(self, servo_id: int, now_s: float) -> list[tuple[int, float]]:
        if servo_id not in self._owed:
            return []
        owed = [entry for entry in self._owed[servo_id] if entry[1] > now_s]
        if owed:
            self._owed[servo_id] = owed
        else:
            del self._owed[servo_id]
        return owed

    def _related(self, servo_ids: _Ids) -> list[deque[_Answered]]:
        """Return what was asked of these servos, alone or in company."""
        kin = self._kin.get(servo_ids)
        if kin is None:
            members = set(servo_ids)
            kin = [past for ids, past in self._answered.items() if not members.isdisjoint(ids)]
            self._kin[servo_ids] = kin
        return kin


def _possible_twins(past: deque[_Answered], now_s: float, *, wary: bool) -> Iterator[_Answered]:
    recent_s, most = (LATEST_S, _WARY_TWINS) if wary else (_TWIN_S, _HEALTHY_TWINS)
    latest = sorted(past, key=_when, reverse=True)[:most] if len(past) > 1 else past
    return (question for question in latest if now_s - question.at_s < recent_s)


def _when(question: _Answered) -> float:
    return question.at_s
