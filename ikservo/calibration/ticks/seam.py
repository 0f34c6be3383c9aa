"""Arithmetic on a circle of ticks, where 4095 and 0 are neighbours; holds for arrays as well."""

from __future__ import annotations

__all__ = ["nearest_turn", "short_way", "unwrapped"]


def short_way(start: int, end: int, turn: int) -> int:
    """Return the shorter signed way from one tick to another around a circle of ``turn``.

    Half a turn counts as backwards: the result lies in [-turn/2, turn/2).
    """
    return (end - start + turn // 2) % turn - turn // 2


def unwrapped(last: int, reading: int, turn: int) -> int:
    """Return a reading counted on from the last unwrapped one, over any number of turns."""
    return last + short_way(last, reading, turn)


def nearest_turn(middle: int, reading: int, turn: int) -> int:
    """Return the reading moved by whole turns to within half a turn of ``middle``."""
    return unwrapped(middle, reading, turn)
