"""Joints that meet a point, and a direction where the arm has one to give (lecture L3, L4)."""

from __future__ import annotations

from collections.abc import Iterator

from ikservo.ik.closed_form.question import Candidate, Question
from ikservo.ik.closed_form.yaw_and_roll import yaw_and_roll

__all__ = ["by_aim", "by_position"]

# Rolls to try, as parts of the range, where the start's own does not reach.
_ROLLS = (0.5, 0.25, 0.75, 0.0, 1.0, 0.125, 0.375, 0.625, 0.875)


def by_position(asked: Question) -> tuple[Candidate, ...]:
    """Return the joints that meet the point with the wrist as at the start.

    The tool is turned as near to the aims as the point allows. A roll that cannot meet the point
    is replaced by the first of a few others that can.
    """
    for roll in (asked.roll_held, *_other_rolls(asked)):
        if found := tuple(_with_roll(asked, roll)):
            return found
    return ()


def by_aim(asked: Question) -> Iterator[Candidate]:
    """Yield the joints that meet the point across and the aims as far as they can.

    Without a roll, or with one that moves nothing, point and aims ask for more than the arm can
    give: what the candidates miss tells whether they happen to agree.
    """
    # The axis that the roll swings most tells the roll best.
    aim = max(asked.aims, key=lambda aim: aim.tool.sway)
    held = (asked.yaw_held, asked.roll_held)
    for phi, psi in yaw_and_roll(asked.point, asked.tip, aim.wanted, aim.tool, held):
        yaw, roll = asked.yaw_inside(phi), asked.roll_inside(psi)
        if yaw is not None and roll is not None:
            yield from asked.placed(yaw, roll, bend=False)


def _with_roll(asked: Question, roll: float) -> Iterator[Candidate]:
    for yaw in asked.yaws(asked.tip.across(roll)):
        yield from asked.placed(yaw, roll, bend=True)


def _other_rolls(asked: Question) -> Iterator[float]:
    if asked.arm.wrist:
        yield from asked.arm.wrist[0].parts(_ROLLS)
