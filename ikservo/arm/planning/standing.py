"""Joints that bring the tip to a point with the tool standing as asked, or as well as it can."""

from __future__ import annotations

from ikservo.arm.planning.asking import Asker
from ikservo.arm.planning.keeping import STANDS_RAD, Standing, kept
from ikservo.arm.planning.stance import Stance
from ikservo.ik import Result, Target, solve
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Vector
from ikservo.model.tool import Tool

__all__ = ["Standing", "check_stance", "stand"]


def stand(chain: Chain, tool: Tool, target: Target, stance: Stance, here: Vector) -> Standing:
    """Find joints for a point, the position exactly and then the stance as well as it can be.

    Args:
        chain: The arm.
        tool: Its axes.
        target: The point.
        stance: How the tool shall stand.
        here: The joints now (dof,): where to start, and what to keep.

    Returns:
        The answer; where ``solution.reached`` is false, nothing reaches the point.

    Raises:
        OrientationError: It is asked for, and more than half a degree is left.
    """
    plain = solve(chain, target, here, posture=stance.posture)
    if not plain.reached or stance.posture is not None:
        return Standing(plain, 0.0)
    if not stance.asked:
        return kept(chain, target, here, plain)
    asker = Asker(chain, tool, target, stance, here)
    best = asker.standing(plain)
    for answer in asker.answers(plain):
        best = min(best, answer, key=lambda each: each.left_rad)
        if best.left_rad < STANDS_RAD:
            break
    asker.check(best)
    return best


def check_stance(
    chain: Chain, tool: Tool, target: Target, stance: Stance, solution: Result
) -> float:
    """Return how far the tool is from how it should stand in a solution, rad.

    Raises:
        OrientationError: It is more than half a degree.
    """
    asker = Asker(chain, tool, target, stance, solution.q)
    return asker.check(asker.standing(solution))
