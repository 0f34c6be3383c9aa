"""Whole numbers of ticks, and nothing that merely looks like one."""

from __future__ import annotations

from ikservo.errors import RefusedError

__all__ = ["check_whole"]


def check_whole(joint: str, tick: object) -> None:
    """Check that a tick is a whole number.

    Raises:
        RefusedError: It is not; names the joint.
    """
    # bool is an int in Python, and True is no place to drive a joint to.
    if not isinstance(tick, int) or isinstance(tick, bool):
        raise RefusedError(f"The goal of {joint} is {tick!r}.", "Expected a whole number of ticks.")
