"""Asking many ids who is there, without waiting for the adapter between them.

An answer names the servo that gives it, so the next question may go out as soon as the wire is
free; what a slow adapter holds back arrives later and is understood all the same.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from ikservo.hardware.line.port import Port
from ikservo.hardware.packets.dialect import LONGEST_RETURN_DELAY_S, Frame
from ikservo.hardware.packets.framing import Framing

__all__ = ["Sweep", "sweep"]

_USB_FRAME_S = 0.001  # two packets may leave the adapter so much closer than they were written
_ECHO_ERROR = 1  # a ping of protocol 1 reads like an answer with this error byte
_HELD_BACK_S = 0.040  # adapters keep bytes for up to 16 ms, busy machines for longer
_SILENT = 3  # pings of one id in vain that are enough
_LATELY = 20  # pings that an adapter may hold the answer back for
_PLENTY = 4096  # bytes; more than any slot brings


@dataclass(slots=True)
class Sweep:
    """Who spoke.

    Attributes:
        frames: Every answer by id, in the order in which they came.
        suspects: Ids in whose time bytes came that are no answer: two servos at once, or noise.
        junk: How many such bytes.
        echoes: Whether the adapter hears itself.
    """

    frames: dict[int, list[Frame]] = field(default_factory=dict[int, "list[Frame]"])
    suspects: set[int] = field(default_factory=set[int])
    junk: int = 0
    echoes: bool = False


def sweep(
    port: Port,
    framing: Framing,
    servo_ids: Iterable[int],
    on_ping: Callable[[int], None] | None = None,
    *,
    echoes: bool | None = None,
    calm: bool = False,
) -> Sweep:
    """Ping ids one after the other at the port's baud rate.

    Args:
        port: The line.
        framing: How to write.
        servo_ids: Whom to ask; an id may come several times.
        on_ping: Called with the number of pings sent so far.
        echoes: Whether the adapter hears itself; None finds out, which takes several ids.
        calm: Wait for each answer, and a while longer for a second one; gives up where the first
            pings bring nothing.

    Raises:
        PortLostError: The line is gone.
    """
    ids = list(servo_ids)
    ear = _Ear(framing)
    with port.exchange():
        port.clearPort()
        for count, servo_id in enumerate(ids, start=1):
            port.writePort(ear.ping(servo_id))
            ear.hear(_listen(port, framing, calm=calm))
            if on_ping:
                on_ping(count)
            if calm and count == _SILENT and not ear.anything:
                break
        tail_s = 0.0 if calm else _HELD_BACK_S
        ear.hear(port.read_until(_PLENTY, port.clock.now_s() + tail_s), final=True)
    return ear.all_heard(ids, echoes)


def _listen(port: Port, framing: Framing, *, calm: bool) -> bytes:
    """Return what comes until the next ping may go out."""
    first = b""
    if calm:
        first = port.read_until(1, port.clock.now_s() + _HELD_BACK_S)
    return first + port.read_until(_PLENTY, port.clock.now_s() + slot_s(port, framing))


def slot_s(port: Port, framing: Framing) -> float:
    """Return after what time the next ping cannot run into the answer to this one."""
    on_wire_s = port.wire_s(framing.ping_bytes + framing.answer_bytes)
    return on_wire_s + LONGEST_RETURN_DELAY_S + _USB_FRAME_S


class _Ear:
    """Finds the answers in what comes, and remembers whose turn it was when rubbish came."""

    def __init__(self, framing: Framing) -> None:
        self._dialect = framing.dialect()
        self._pending = b""
        self._lately: list[int] = []
        self._sweep = Sweep()

    @property
    def anything(self) -> bool:
        """Whether any byte came."""
        return bool(self._pending or self._sweep.frames or self._sweep.junk)

    def ping(self, servo_id: int) -> bytes:
        """Return the packet that asks an id."""
        self._lately = [*self._lately[-_LATELY:], servo_id]
        return self._dialect.ping(servo_id)

    def hear(self, data: bytes, *, final: bool = False) -> None:
        """Take down what came since the last call."""
        said = self._pending + data
        heard = self._dialect.scan(said, final=final)
        self._pending = said[len(said) - heard.pending :]
        for frame in heard.frames:
            self._sweep.frames.setdefault(frame.servo_id, []).append(frame)
        if heard.junk:
            self._sweep.junk += heard.junk
            self._sweep.suspects.update(self._lately)

    def all_heard(self, ids: list[int], echoes: bool | None) -> Sweep:
        """Return who spoke besides ourselves."""
        asked, said = Counter(ids), self._sweep
        said.echoes = self._hears_itself(asked) if echoes is None else echoes
        if said.echoes:
            for servo_id, count in asked.items():
                self._drop_echoes(servo_id, count)
        said.frames = {i: rows for i, rows in said.frames.items() if rows and i in asked}
        return said

    def _hears_itself(self, asked: Counter[int]) -> bool:
        """An adapter that hears itself repeats every ping; a servo can do so with its own only."""
        return len(asked) > 1 and all(len(self._echoes(i)) >= asked[i] for i in asked)

    def _drop_echoes(self, servo_id: int, count: int) -> None:
        for echo in self._echoes(servo_id)[:count]:
            self._sweep.frames[servo_id].remove(echo)

    def _echoes(self, servo_id: int) -> list[Frame]:
        return [f for f in self._sweep.frames.get(servo_id, ()) if _like_a_ping(f)]


def _like_a_ping(frame: Frame) -> bool:
    return frame.error == _ECHO_ERROR and not frame.data
