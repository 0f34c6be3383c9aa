"""A broadcast ping: everybody answers in turn, and two servos on one id give themselves away."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from ikservo.hardware.packets.dialect import Frame, Heard
from ikservo.hardware.packets.exchange import Exchange
from ikservo.hardware.packets.replies import Status

__all__ = ["RollCall", "hear_all"]

_SLOT_BYTES = 14  # the longest answer to a ping
_LONGEST_PAUSE_S = 0.003  # the most that a servo keeps from the one before it
_MARGIN = 2.0  # times the pace at which servos have answered so far


@dataclass(frozen=True, slots=True)
class RollCall:
    """Who answered.

    Attributes:
        answers: Every answer by id; two of one id are two servos, or one answer doubled.
        junk: Bytes that belong to no answer: noise, or several servos speaking at once.
    """

    answers: Mapping[int, tuple[Status, ...]]
    junk: int


def hear_all(exchange: Exchange, send: Callable[[], int], size: int, highest_id: int) -> RollCall:
    """Send a broadcast ping and listen until nobody up to an id can still answer.

    Servos answer in the order of their ids, each in its slot. The SDK's own always waits for 253
    slots of 3 ms, busily (D13). Here the wait ends with the slot of the highest id, and the first
    answers tell how long a slot is.

    Raises:
        PortLostError: The line is gone.
    """
    port = exchange.port
    raw, heard = bytearray(), Heard((), 0, 0)
    with port.exchange():
        exchange.send(send)
        started_s = port.clock.now_s()
        slot_s = port.wire_s(_SLOT_BYTES) + _LONGEST_PAUSE_S
        while True:
            end_s = started_s + exchange.return_delay_s + (highest_id + 1) * slot_s
            chunk = port.read_until(1 + port.getBytesAvailable(), end_s + port.patience.allowance_s)
            if not chunk:
                break
            raw += chunk
            heard = _scan(exchange, raw, size, final=False)
            if heard.frames:
                took_s = port.clock.now_s() - started_s
                slot_s = min(slot_s, _MARGIN * took_s / (heard.frames[-1].servo_id + 1))
    heard = _scan(exchange, raw, size, final=True)
    return RollCall(_answers(exchange, heard.frames, size), heard.junk)


def _scan(exchange: Exchange, raw: bytearray, size: int, *, final: bool) -> Heard:
    return exchange.dialect.scan(bytes(raw).removeprefix(exchange.port.sent), (size,), final=final)


def _answers(
    exchange: Exchange, frames: Iterable[Frame], size: int
) -> dict[int, tuple[Status, ...]]:
    answers: dict[int, tuple[Status, ...]] = {}
    for frame in frames:
        reply = exchange.dialect.judge(frame, size)
        if isinstance(reply, Status):
            answers[reply.servo_id] = (*answers.get(reply.servo_id, ()), reply)
    return answers
