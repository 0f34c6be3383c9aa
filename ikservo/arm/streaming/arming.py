"""Before goals are streamed: limits and watchdogs stand in the servos, and all of them are well."""

from __future__ import annotations

import contextlib

from ikservo.arm.streaming.health_round import HealthRound
from ikservo.arm.streaming.limits_in_servos import LimitsInServos
from ikservo.clock import Clock
from ikservo.errors import HeldUpError

__all__ = ["arm_servos"]

# Watchdogs are armed in less than this, or armed again so many times.
_SOON_S, _ATTEMPTS = 0.08, 3


def arm_servos(
    limits: LimitsInServos, health_round: HealthRound | None, clock: Clock, horn_rad_s: float
) -> float:
    """Set limits and watchdogs and hear that all is well: again where that took too long.

    A watchdog that trips meanwhile takes the limits with it.

    Args:
        limits: Of the servos.
        health_round: Asks how they are; None before torque was ever switched on.
        clock: The line's time.
        horn_rad_s: The top speed of the motion.

    Returns:
        From when on the first beat counts, so that no pause in between is overlooked.

    Raises:
        BusError: A servo does not answer.
        ServoAlarmError: A servo is not well.
        HeldUpError: The program was held up again and again.
    """

    def armed_s() -> float:
        limits.run_at(horn_rad_s)
        since_s = clock.now_s()
        limits.arm_watchdog()
        if health_round:
            health_round.begin()
        return since_s

    for _ in range(_ATTEMPTS):
        with contextlib.suppress(HeldUpError):  # one has tripped already
            since_s = armed_s()
            if clock.now_s() - since_s < _SOON_S or not limits.watched:
                return since_s
        limits.disarm_watchdog()
        limits.forget()
    armed_s()
    return clock.now_s()  # the line is as slow as that
