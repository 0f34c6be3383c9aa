"""Checks of the order, age and rate of a client's messages."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from ikservo.apps.page.messages.message_fields import PageMessage
from ikservo.apps.page.messages.page_messages import (
    BadMessageError,
    DragTool,
    Gamepad,
    Heartbeat,
    OrbitCamera,
    Pointer,
    SetViewport,
    Stop,
    TrackHand,
    Wheel,
)
from ikservo.apps.page.picking.projection import Viewport
from ikservo.apps.page.picking.viewpoints import Viewpoint
from ikservo.apps.page.server.auth import Permission

_MessageT = TypeVar("_MessageT", bound=PageMessage)

MAX_MESSAGE_AGE_S = 1.0
"""Age of the shown scene, in seconds, above which commands from the page are ignored."""

_RATE_HZ = 400.0
_BURST = 200.0
_MAX_BAD_MESSAGES = 20
_MAX_REMEMBERED = 256
_STREAMED = Heartbeat | Wheel | OrbitCamera | Gamepad | TrackHand  # the next message replaces it


class StaleMessageError(BadMessageError):
    """A command that is too old to act on, for example from a hidden page; not an attack."""


class StalePressError(StaleMessageError):
    """A press or typed value that is too old to act on; the user is told."""


class RateLimitError(BadMessageError):
    """Too many messages, or too many invalid ones; the connection is closed."""


class MessageFilter(Generic[_MessageT]):
    """Parser of the messages on one connection; checks order, age and rate.

    Args:
        now_s: The time at which the client connected.
        read: Parses and validates a message.

    Attributes:
        seen: Number of the last scene that the page has drawn.
    """

    def __init__(self, now_s: float, read: Callable[[str], _MessageT]) -> None:
        self._last_seq, self._read = 0, read
        self._tokens, self._filled_s = _BURST, now_s
        self._bad = 0
        self._sent: OrderedDict[int, float] = OrderedDict({0: now_s})
        self._scene = self.seen = 0

    @property
    def frames_in_flight(self) -> int:
        """Number of scenes that were sent but not drawn yet."""
        return self._scene - self.seen

    def record_sent(self, now_s: float) -> int:
        """Record the send time of a scene, which gives the age of replies; return its number."""
        self._scene += 1
        self._sent[self._scene] = now_s
        while len(self._sent) > _MAX_REMEMBERED:
            self._sent.popitem(last=False)
        return self._scene

    def accept(self, text: str, now_s: float) -> _MessageT:
        """Return a message that may be acted on.

        Raises:
            BadMessageError: The message is malformed or a replay; nothing changes.
            StalePressError: The message is a press or typed value, and too old; nothing changes.
            StaleMessageError: The message is too old; nothing changes.
            RateLimitError: The connection must be closed.
        """
        self._tokens = min(_BURST, self._tokens + (now_s - self._filled_s) * _RATE_HZ)
        self._filled_s = now_s
        if self._tokens < 1.0:
            raise RateLimitError("Too many messages.", f"At most {_RATE_HZ:.0f} per second.")
        self._tokens -= 1.0
        try:
            message = self._read(text)
            self._check_sequence(message)
        except BadMessageError as error:
            self._bad += 1
            if self._bad > _MAX_BAD_MESSAGES:
                raise RateLimitError("Too many invalid messages.") from error
            raise
        # Holding is never too late; a page sends its viewport once, often during the slow first
        # second of its layout.
        is_always_accepted = (
            isinstance(message, Stop | SetViewport)
            or (isinstance(message, Heartbeat) and not message.visible)
            or (isinstance(message, TrackHand) and not message.held)
        )
        age_s = now_s - self._sent.get(message.seen + 1, now_s)  # age of the first scene not drawn
        if age_s > MAX_MESSAGE_AGE_S and not is_always_accepted:
            is_movement = isinstance(message, Pointer | DragTool) and message.phase != "down"
            if is_movement or isinstance(message, _STREAMED):
                raise StaleMessageError("The message is too old to act on.", "Nothing has changed.")
            raise StalePressError(
                f"The picture on this page was more than {MAX_MESSAGE_AGE_S:.0f} s old, so "
                "nothing was done.",
                "Try again. If this persists, close other programs, and switch 3D off if it is on.",
            )
        return message

    def _check_sequence(self, message: PageMessage) -> None:
        if message.seq <= self._last_seq:
            raise BadMessageError(
                f"Message {message.seq} was received before.", "Use a higher number."
            )
        if message.seen < self.seen or message.seen not in self._sent:
            raise BadMessageError(f"Scene {message.seen} was never sent or is too old.")
        self._last_seq, self.seen = message.seq, message.seen


@dataclass(slots=True)
class Client:
    """One open page.

    Attributes:
        number: Number that identifies the client.
        permission: The permission of its key.
        view: The viewpoint of the client.
        lease: The last lease of control that it was given; empty if none.
        viewport: Size of the drawing; None until it is received.
        webgl: Whether the page draws in 3D.
        handles: Whether the page also draws handles on the tool.
        height_m: The height above the table for clicks in a camera's picture.
        sent: The last frame of each kind, so that nothing is sent twice.
        sent_s: The time at which the last frame of each kind was sent.
        outbox: Replies that only this page gets.
    """

    number: int
    permission: Permission
    view: Viewpoint
    lease: str = ""
    viewport: Viewport | None = None
    webgl: bool = False
    handles: bool = False
    height_m: float = 0.0
    sent: dict[str, object] = field(default_factory=dict[str, object])
    sent_s: dict[str, float] = field(default_factory=dict[str, float])
    outbox: list[Mapping[str, object]] = field(default_factory=list[Mapping[str, object]])

    def unsent(self, frame: Mapping[str, object]) -> list[Mapping[str, object]]:
        """Return a frame in a list, unless an equal frame of its kind was the last one sent."""
        kind = str(frame["kind"])
        if self.sent.get(kind) == frame:
            return []
        self.sent[kind] = frame
        return [frame]

    def take_outbox(self) -> list[Mapping[str, object]]:
        """Return and remove the replies that have not been sent yet."""
        replies, self.outbox = self.outbox, []
        return replies
