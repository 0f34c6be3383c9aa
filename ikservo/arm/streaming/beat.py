"""One beat of a streamed motion, for whoever watches or re-aims it."""

from __future__ import annotations

from dataclasses import dataclass

from ikservo.kinematics.se3 import Vector

__all__ = ["Beat"]


@dataclass(frozen=True, slots=True, eq=False)
class Beat:
    """What was told and heard at one beat.

    Attributes:
        time_s: Of the motion: the time of its course, not of the clock.
        duration_s: Of the whole motion; infinite for one that goes on until it is ended.
        goals: Where the servos were told to go (n,), rad or m.
        measured: Where the joints are (n,); of a joint in ``lost``, where it was last seen.
        late_s: How much longer than its period the beat before took.
        lost: Joints whose answer is missing.
    """

    time_s: float
    duration_s: float
    goals: Vector
    measured: Vector
    late_s: float = 0.0
    lost: tuple[str, ...] = ()
