"""One motion of the servos, streamed beat by beat."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ikservo.arm.servos import Servos
from ikservo.guard import Fence, Following
from ikservo.kinematics.se3 import Vector
from ikservo.motion import Course, Metronome

__all__ = ["BEAT_S", "Watcher", "travel"]

BEAT_S = 0.01
# A late beat must not make goals leap: the motion goes on from where it was, a little later.
_LONGEST_BEAT_S = 0.04

# At full speed a P-controlled servo is up to 5° behind, and its load pulls it as far again.
_BEHIND_TICKS = 228  # 20°

Watcher = Callable[[float, float, Vector], None]
"""Called at each beat with elapsed and whole duration [s] and the measured joints (n,)."""


def travel(servos: Servos, move: Course, watch: Watcher | None = None) -> None:
    """Stream the goals of a motion to the servos until its end.

    Raises:
        RefusedError: The guard stopped it, or a joint does not follow; the servos hold the last
            goal that passed.
    """
    following = Following(servos.names, np.array([_behind(fence) for fence in servos.fences]))
    motion_s = last_s = 0.0
    for elapsed_s in Metronome(servos.clock, BEAT_S):
        motion_s += min(elapsed_s - last_s, _LONGEST_BEAT_S)
        last_s = elapsed_s
        servos.command(move.state(motion_s).position)
        measured = servos.measure()
        following.see(servos.goals(), measured)
        if watch:
            watch(min(motion_s, move.duration_s), move.duration_s, measured)
        if motion_s >= move.duration_s:
            return


def _behind(fence: Fence) -> float:
    return _BEHIND_TICKS * fence.joint_map.unit_per_tick
