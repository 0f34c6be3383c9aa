"""Two servos with one id are found out before anything is made of what they say."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Generator, Iterator

from ikservo.errors import BadReplyError, BusError, CalibrationError
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.finding.sweep import sweep
from ikservo.hardware.line.port import Port
from ikservo.hardware.packets.framing import FRAMINGS, Framing
from ikservo.hardware.servo import ServoSpec

__all__ = ["UNCROWD", "crowded", "refuse_crowds", "refusing_crowds"]

UNCROWD = "Several servos may share one id. Give each its own, one at a time: ikservo setup ARM"

_PINGS = 6  # of each id; the answers of two servos fit over each other by chance now and then
_LOOKS = 24  # pings of an id that is looked at more closely
_ODD = 8  # of them that two servos spoil at least, and that a bad line does not


@contextlib.contextmanager
def refusing_crowds(bus: ServoBus) -> Generator[None]:
    """Ask servos something, and say so if two with one id spoilt it.

    Two that share an id damage or double each other's answers, or contradict the arm file. Where
    nothing of this happened nothing more is asked, so that a healthy line loses no time.

    Raises:
        BadReplyError: More than one servo answers at an id; names all such.
        PortLostError: The line is gone.
    """
    try:
        yield
    except (BusError, CalibrationError):
        refuse_crowds(bus)
        raise
    if bus.port.trust.sick:
        refuse_crowds(bus)


def refuse_crowds(bus: ServoBus) -> None:
    """Find out whether two servos share an id; see ``crowded``.

    Raises:
        BadReplyError: More than one servo answers at an id; names all such.
        PortLostError: The line is gone.
    """
    crowds = crowded(bus)
    if crowds:
        named = ", ".join(map(str, crowds))
        raise BadReplyError("answers like several servos", UNCROWD, servo=named, port=bus.port.name)


def crowded(bus: ServoBus) -> list[ServoSpec]:
    """Return the servos at whose ids more than one answers.

    Each is pinged a few times, and more often where an answer is damaged or doubled. This takes
    about 10 ms a servo, whatever the adapter's latency, and writes nothing.

    Raises:
        PortLostError: The line is gone.
    """
    crowds: list[int] = []
    for framing in FRAMINGS:
        ids = [i for i, servo in bus.servos.items() if servo.table.family in framing.families]
        crowds += _crowds(bus.port, framing, ids) if ids else ()
    return [servo for servo in bus.servos.values() if servo.id in crowds]


def _crowds(port: Port, framing: Framing, ids: Collection[int]) -> Iterator[int]:
    absent = next(i for i in framing.ids if i not in ids)  # an echo of what nobody answers tells
    heard = sweep(port, framing, [absent, *(_PINGS * [*ids])])
    for servo_id in ids:
        odd = heard.junk or len(heard.frames.get(servo_id, ())) > _PINGS
        if odd and _is_crowd(port, framing, servo_id, echoes=heard.echoes):
            yield servo_id


def _is_crowd(port: Port, framing: Framing, servo_id: int, *, echoes: bool) -> bool:
    heard = sweep(port, framing, _LOOKS * [servo_id], echoes=echoes, calm=True)
    surplus = len(heard.frames.get(servo_id, ())) - _LOOKS
    return surplus >= _ODD or bool(heard.junk and surplus <= -_ODD)
