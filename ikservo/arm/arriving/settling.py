"""Bringing the joints to where a motion without a plan ended, for load keeps them from it."""

from __future__ import annotations

from ikservo.arm.arriving.correction import Correction
from ikservo.arm.skills.workings import Workings
from ikservo.arm.streaming.beat import Beat
from ikservo.kinematics.se3 import Vector
from ikservo.motion import Course

__all__ = ["settle"]


def settle(arm: Workings, goal: Vector, speed: str) -> Vector:
    """Lead the arm's goals until its joints stand at ``goal`` (n,), as near as they can.

    A gripper keeps its goal: it may hold something.

    Args:
        arm: At rest, its goals near there.
        goal: Where the joints belong, rad or m.
        speed: slow, normal or fast.

    Returns:
        Where they were at the last beat (n,).
    """
    fences, corrections = arm.servos.fences, list[Correction]()
    joints = zip(fences, goal.tolist(), strict=True)
    wanted = [f.tick(at) if f.joint in arm.chain.names else None for f, at in joints]

    def begin(here: Vector) -> Course:
        goals = [f.tick(at) for f, at in zip(fences, here.tolist(), strict=True)]
        corrections.append(Correction(fences, goals, wanted, arm.planner.paces(speed)))
        return corrections[0]

    def look(beat: Beat) -> None:
        corrections[0].see(beat.time_s, beat.measured)

    return arm.drive(begin, look, speed)
