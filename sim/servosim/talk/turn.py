"""Who speaks when after an instruction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from servosim.servo import Servo

__all__ = ["BROADCAST", "Reply", "Turn", "by_id", "one_turn"]

BROADCAST = 0xFE


class Reply(NamedTuple):
    """Bytes that a servo sends."""

    servo: Servo
    data: bytes


class Turn(NamedTuple):
    """A place in the order of answers.

    Attributes:
        replies: Everybody who takes this place; more than one collide.
        size: Bytes that the next in line waits for when nobody takes it.
        slot: A fixed place counted in packets from the instruction (broadcast ping), or None to
            follow the turn before.
        prompt: True to follow the turn before without a return delay (fast reads).
    """

    replies: tuple[Reply, ...]
    size: int = 0
    slot: int | None = None
    prompt: bool = False


def by_id(servos: Sequence[Servo]) -> dict[int, list[Servo]]:
    """Return who answers to which id."""
    found: dict[int, list[Servo]] = {}
    for servo in servos:
        found.setdefault(servo.id, []).append(servo)
    return found


def one_turn(replies: list[Reply]) -> list[Turn]:
    """Return the turns of an instruction to one id: everybody with that id answers at once."""
    return [Turn(tuple(replies))] if replies else []
