"""One motion of the servos: stream it beat by beat, wait for rest, take out what load left."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ikservo.arm.servos import Servos
from ikservo.errors import NotSettledError
from ikservo.guard import Fence, Following
from ikservo.kinematics.se3 import Vector
from ikservo.motion import JointMove, Metronome, Pace

__all__ = ["Watcher", "correct", "settle", "travel"]

BEAT_S = 0.01
# A late beat must not make goals leap: the motion goes on from where it was, a little later.
_LONGEST_BEAT_S = 0.04

# At full speed a P-controlled servo is up to 5° behind, and its load pulls it as far again.
_BEHIND_TICKS = 228  # 20°

_STILL_TICKS = 2
_STILL_BEATS = 5
_SETTLE_S = 3.0

# Servos without an integral part sag under their load by up to this; more is a jam.
_LARGEST_CORRECTION_RAD = 0.12
_ROUNDS = 4

Watcher = Callable[[float, float, Vector], None]
"""Called at each beat with elapsed and whole duration [s] and the measured joints (n,)."""


def travel(servos: Servos, move: JointMove, watch: Watcher | None = None) -> None:
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
        servos.command(move.at(motion_s))
        measured = servos.measure()
        following.see(servos.goals(), measured)
        if watch:
            watch(min(motion_s, move.duration_s), move.duration_s, measured)
        if motion_s >= move.duration_s:
            return


def _behind(fence: Fence) -> float:
    return _BEHIND_TICKS * fence.joint_map.unit_per_tick


def settle(servos: Servos) -> Vector:
    """Wait until no joint moves any more; return where they are (n,), rad or m.

    Raises:
        NotSettledError: Some joint still moves after three seconds.
    """
    still, last = 0, servos.measure()
    quiet = np.array([_STILL_TICKS * fence.joint_map.unit_per_tick for fence in servos.fences])
    for elapsed_s in Metronome(servos.clock, BEAT_S):
        now = servos.measure()
        moving = np.abs(now - last) > quiet
        still, last = (0 if moving.any() else still + 1), now
        if still > _STILL_BEATS:
            return now
        if elapsed_s > _SETTLE_S:
            names = ", ".join(np.array(servos.names)[moving].tolist())
            raise NotSettledError(
                f"{names or 'The arm'} does not come to rest.", "Look for a loose horn or load."
            )
    raise AssertionError("the metronome never ends")


def correct(servos: Servos, goal: Vector, measured: Vector, paces: list[Pace]) -> Vector:
    """Lead the goals by what the load keeps the joints from reaching.

    Args:
        servos: The arm at rest.
        goal: Where the joints should be (n,), rad or m.
        measured: Where they are (n,).
        paces: How fast each may be moved.

    Returns:
        Where the joints are in the end (n,).
    """
    half_tick = np.array([0.5 * fence.joint_map.unit_per_tick for fence in servos.fences])
    for _ in range(_ROUNDS):
        residual = goal - measured
        if (np.abs(residual) <= half_tick).all():
            break
        lead = np.clip(
            servos.goals() + residual - goal, -_LARGEST_CORRECTION_RAD, _LARGEST_CORRECTION_RAD
        )
        wanted = servos.nearest(goal + lead)
        if np.array_equal(wanted, servos.goals()):
            break
        travel(servos, JointMove(servos.goals(), wanted, paces))
        measured = settle(servos)
    return measured
