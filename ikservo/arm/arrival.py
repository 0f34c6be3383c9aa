"""Arrival: wait until the joints are at rest, then take out what load left of the error."""

from __future__ import annotations

import numpy as np

from ikservo.arm.journey import BEAT_S, travel
from ikservo.arm.servos import Servos
from ikservo.errors import NotSettledError
from ikservo.kinematics.se3 import Vector
from ikservo.motion import JointMove, Metronome, Pace

__all__ = ["correct", "settle"]

_STILL_TICKS = 2
_STILL_BEATS = 5
_SETTLE_S = 3.0

# Servos without an integral part sag under their load by up to this; more is a jam.
_LARGEST_CORRECTION_RAD = 0.12
_ROUNDS = 4


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
