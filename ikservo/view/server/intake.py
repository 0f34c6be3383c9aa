"""What a connection lets in: not too much, nothing twice, nothing stale."""

from __future__ import annotations

from collections import OrderedDict

from ikservo.view.server.messages import BadMessageError, Beat, Look, Message, Stop, read_message

__all__ = ["LARGEST_AGE_S", "Intake", "StaleError", "TooManyError"]

LARGEST_AGE_S = 1.0
"""A command that was given while the page showed a scene older than this is none."""

_RATE_HZ = 400.0
_BURST = 200.0
_MOST_BAD = 20
_REMEMBERED = 256


class StaleError(BadMessageError):
    """A command that is too old to act on, as from a page that was hidden; no attack."""


class TooManyError(BadMessageError):
    """A connection that says too much, or too much that is none; it is closed."""


class Intake:
    """Reads the messages of one connection, in order."""

    def __init__(self, now_s: float) -> None:
        self._last_seq = 0
        self._tokens, self._filled_s = _BURST, now_s
        self._bad = 0
        self._sent: OrderedDict[int, float] = OrderedDict({0: now_s})
        self._scene = self.seen = 0

    @property
    def under_way(self) -> int:
        """Return how many scenes were sent that nobody has drawn yet."""
        return self._scene - self.seen

    def note_sent(self, now_s: float) -> int:
        """Remember when a scene left, which dates what is said in answer to it; return which."""
        self._scene += 1
        self._sent[self._scene] = now_s
        while len(self._sent) > _REMEMBERED:
            self._sent.popitem(last=False)
        return self._scene

    def accept(self, text: str, now_s: float) -> Message:
        """Return a message that may act.

        Raises:
            BadMessageError: It is malformed or was there before; nothing changes.
            StaleError: It is too old; nothing changes.
            TooManyError: The connection is to be closed.
        """
        self._spend(now_s)
        try:
            message = read_message(text)
            self._in_order(message)
        except BadMessageError as error:
            self._bad += 1
            if self._bad > _MOST_BAD:
                raise TooManyError("Too many invalid messages.") from error
            raise
        if not _never_too_late(message) and self._age_s(message.seen, now_s) > LARGEST_AGE_S:
            raise StaleError("The message is too old to act on.", "Nothing has changed.")
        return message

    def _spend(self, now_s: float) -> None:
        self._tokens = min(_BURST, self._tokens + (now_s - self._filled_s) * _RATE_HZ)
        self._filled_s = now_s
        if self._tokens < 1.0:
            raise TooManyError("Too many messages.", f"At most {_RATE_HZ:.0f} a second.")
        self._tokens -= 1.0

    def _in_order(self, message: Message) -> None:
        if message.seq <= self._last_seq:
            raise BadMessageError(
                f"Message {message.seq} was received before.", "Number it higher."
            )
        if message.seen < self.seen or message.seen not in self._sent:
            raise BadMessageError(f"Scene {message.seen} was never sent, or long ago.")
        self._last_seq, self.seen = message.seq, message.seen

    def _age_s(self, scene: int, now_s: float) -> float:
        """Return how long the scene that came after the drawn one has been on its way."""
        after = next((at_s for seq, at_s in self._sent.items() if seq > scene), now_s)
        return now_s - after


def _never_too_late(message: Message) -> bool:
    """Return whether it moves nothing, or only makes the arm hold.

    A page says once how large its drawing is, often in the second in which it is laid out.
    """
    holds = isinstance(message, Stop) or (isinstance(message, Beat) and not message.visible)
    return holds or isinstance(message, Look)
