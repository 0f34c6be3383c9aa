"""One question on the line and the answers to it, put so that no older answer can pass for them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from ikservo.errors import BusError, PortLostError
from ikservo.hardware.line.port import Port
from ikservo.hardware.packets.dialect import LONGEST_RETURN_DELAY_S, Dialect
from ikservo.hardware.packets.listening import Listening
from ikservo.hardware.packets.replies import Fault, FaultKind, Reply, Status
from ikservo.hardware.packets.span import Span

__all__ = ["Exchange"]

_NOBODY: Mapping[int, int] = {}


class Exchange:
    """Puts questions on a port and hears the answers out.

    Attributes:
        port: The line.
        dialect: How answers are written.
    """

    def __init__(self, port: Port, dialect: Dialect) -> None:
        self.port, self.dialect = port, dialect
        self._return_delay_s = LONGEST_RETURN_DELAY_S

    @property
    def return_delay_s(self) -> float:
        """Return the longest a servo waits before it answers, seconds."""
        return self._return_delay_s

    def set_return_delay(self, return_delay_s: float) -> None:
        """Wait no longer than this before each answer, seconds: what the servos' registers say."""
        self._return_delay_s = return_delay_s

    def window(
        self, servo_ids: tuple[int, ...], span: Span, size_of: Callable[[int], int] = int
    ) -> Span:
        """Return the window through which a span is best read now.

        It is the span itself unless an answer of that length is still owed by one of the servos;
        see ``Ghosts``. If answers of every length are owed, time passes until none is.
        """
        port = self.port
        find = port.ghosts.window
        found = find(servo_ids, span, port.clock.now_s(), port.trust, size_of)
        if found is None:
            self.wait_out(servo_ids)
        return found or span

    def wait_out(self, servo_ids: tuple[int, ...]) -> None:
        """Let time pass until no older answer of these servos can come any more."""
        port = self.port
        quiet_s = port.ghosts.quiet_from_s(servo_ids, port.clock.now_s(), port.trust)
        port.clock.sleep_until(quiet_s)

    def ask(
        self,
        send: Callable[[], int],
        sizes: Mapping[int, int] = _NOBODY,
        asked: Mapping[int, Span] | Span | None = None,
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
                return self._heard_out(sizes, asked) if sizes else {}
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

    def _heard_out(
        self, sizes: Mapping[int, int], asked: Mapping[int, Span] | Span | None
    ) -> dict[int, Reply]:
        doubtful = self._doubtful(sizes) if asked is None else ()
        delays_s = len(sizes) * self.return_delay_s
        replies = Listening(self.port, self.dialect, sizes).replies(delays_s)
        self._remember(replies, sizes, asked)
        for servo_id in doubtful:
            reply = replies[servo_id]
            if isinstance(reply, Status):
                replies[servo_id] = replace(reply, doubtful=True)
        return replies

    def _doubtful(self, sizes: Mapping[int, int]) -> list[int]:
        """Return whose answers to what was just sent cannot be told from older ones."""
        port, now_s = self.port, self.port.clock.now_s()
        ghosts, trust = port.ghosts, port.trust
        if not trust.wary:
            return [i for i, size in sizes.items() if ghosts.owed(i, size, now_s)]
        return [i for i, size in sizes.items() if ghosts.clash((i,), size, port.sent, now_s, trust)]

    def _remember(
        self,
        replies: Mapping[int, Reply],
        sizes: Mapping[int, int],
        asked: Mapping[int, Span] | Span | None,
    ) -> None:
        ghosts, now_s = self.port.ghosts, self.port.clock.now_s()
        if isinstance(asked, Span) and all(type(reply) is Status for reply in replies.values()):
            ghosts.answered(tuple(sizes), next(iter(sizes.values())), asked, now_s)
            return
        answered: dict[tuple[int, object], list[int]] = {}
        for servo_id, reply in replies.items():
            if isinstance(reply, Fault) and reply.kind is not FaultKind.REFUSED:
                ghosts.owes(servo_id, sizes[servo_id], now_s)
                continue
            what = asked.get(servo_id) if isinstance(asked, Mapping) else asked or self.port.sent
            answered.setdefault((sizes[servo_id], what), []).append(servo_id)
        for (size, what), servo_ids in answered.items():
            ghosts.answered(tuple(servo_ids), size, what, now_s)
