"""One serial line: whose turn it is, what may still come, and how far it can be believed."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Generator
from types import TracebackType

from ikservo.hardware.line.transport import Transport, open_transport
from ikservo.hardware.line.vendor_port import VendorPort
from ikservo.hardware.packets.ghosts import Ghosts
from ikservo.hardware.packets.trust import Pace, Trust

__all__ = ["Port", "open_port"]


def open_port(name: str, baud_rate: int) -> Port:
    """Open a port by its name, see ``open_transport``.

    Raises:
        PortError: It does not exist, is busy or may not be opened.
    """
    return Port(open_transport(name, baud_rate), name, baud_rate)


class Port(VendorPort):
    """One serial line, used by one thread at a time.

    What differs from the vendors' ``PortHandler``: stale input is really discarded (F1, D6),
    waits are sized to the question (F2), time is monotonic (F3, D7), reads block instead of
    spinning (F4), the port is exclusive (F5), every baud rate goes (F6, D8), and a lost line
    is one named error.

    Attributes:
        transport: What carries the bytes; nobody but the port reads or writes it.
        name: As the person gave it.
        clock: The transport's own virtual clock, or the machine's.
        lock: Held during a question and its answer (F17, D14).
        sent: The bytes of the latest question.
        echoes: Whether the adapter hears itself; None while that is unknown.
        patience: How long to wait beyond what the wire takes.
        pace: How soon an answer can come at the earliest.
        trust: Whether the line has shown that it repeats or damages packets.
        ghosts: Which answers may still come.
        is_using: The SDKs' own busy flag; ``exchange`` always clears it (F8, D9).
    """

    def __init__(self, transport: Transport, name: str, baud_rate: int) -> None:
        self.lock = threading.RLock()
        super().__init__(transport, name, baud_rate)

    def connect(self, transport: Transport, name: str, baud_rate: int) -> None:
        """Talk through another transport from now on; what was learned of the old is forgotten."""
        super().connect(transport, name, baud_rate)
        self.pace, self.trust, self.ghosts = Pace(), Trust(), Ghosts()
        self.echoes: bool | None = None

    @contextlib.contextmanager
    def exchange(self) -> Generator[None]:
        """Hold the line for one question and its answer, and leave it usable whatever happens."""
        with self.lock:
            try:
                yield
            finally:
                self.is_using = False

    def stale_bytes(self, count: int) -> int:
        """Return how many of the bytes heard since the question are older than it."""
        since_s = self.clock.now_s() - self.sent_all_s
        return self.pace.stale(count - self._echoed, since_s, self.wire_s(1))

    @property
    def is_calm(self) -> bool:
        """Whether all has been well of late, and nothing but the next answer can come."""
        return not (self.trust.wary or self.ghosts.any_owed)

    def learn(self, heard: bytes | bytearray, answered: int) -> None:
        """Learn from a complete answer.

        Args:
            heard: Everything that came since the question.
            answered: Bytes of the answers themselves.
        """
        if self.sent in heard[: len(heard) - answered]:
            self.echoes = True
        elif len(heard) == answered:  # nothing else came, not even half an echo
            self.echoes = False
        since_s = self.clock.now_s() - self.sent_all_s
        self.patience.learn(since_s - self.wire_s(len(heard) - self._echoed))
        self.pace.learn(answered, since_s, self.wire_s(1))

    @property
    def _echoed(self) -> int:
        """Return how many bytes that come back may be our own."""
        return 0 if self.echoes is False else len(self.sent)

    def close(self) -> None:
        """Give the line back; a line that is already lost is no trouble."""
        self.closePort()

    def __enter__(self) -> Port:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.closePort()
