"""What a control cycle tells whoever watches a motion."""

from __future__ import annotations

from ikservo.arm.reports import Progress
from ikservo.arm.streaming.beat import Beat
from ikservo.kinematics.se3 import Vector

__all__ = ["progress_of"]


def progress_of(beat: Beat, tip_m: Vector, names: tuple[str, ...]) -> Progress:
    """Return the state of a motion in one control cycle.

    Args:
        beat: What was told and heard.
        tip_m: The measured tip (3,), metres.
        names: The joints, in the order of the cycle's vectors.
    """
    return Progress(
        beat.time_s, beat.duration_s, tip_m, beat.measured.copy(), beat.goals.copy(), names
    )
