"""Prepare servos for a motion: set limits, arm watchdogs, read telemetry."""

from __future__ import annotations

import contextlib

from ikservo.clock import Clock
from ikservo.control.health_polling import HealthPoller
from ikservo.control.servo_limits import ServoRamLimits
from ikservo.errors import HeldUpError

_WATCHDOG_DELAY_S = 0.08  # longest time to arm the watchdogs: the first of them trips after 0.1 s
_ATTEMPTS = 10  # most attempts to arm them within that time


def prepare_servos(
    limits: ServoRamLimits, health_poller: HealthPoller | None, clock: Clock, horn_rad_s: float
) -> float:
    """Set limits, arm watchdogs and read all telemetry; repeat if that took too long.

    A watchdog that trips in the meantime resets the limits.

    Args:
        limits: The limits of the servos.
        health_poller: Reads the telemetry; None before torque was first switched on.
        clock: The clock of the bus.
        horn_rad_s: The top speed of the motion.

    Returns:
        The start time of the first cycle, which includes any pause since then.

    Raises:
        BusError: A servo does not answer.
        ServoAlarmError: A servo reports a fault.
        HeldUpError: The program was delayed in every attempt.
    """

    def arm_watchdogs() -> float:
        limits.set_speed(horn_rad_s)
        since_s = clock.now_s()
        limits.arm_watchdog()
        if health_poller:
            health_poller.poll_all()
        return since_s

    for _ in range(_ATTEMPTS):
        with contextlib.suppress(HeldUpError):  # a watchdog has tripped already
            since_s = arm_watchdogs()
            if clock.now_s() - since_s < _WATCHDOG_DELAY_S or not limits.watchdog_ids:
                return since_s
        limits.disarm_watchdog()
        limits.invalidate()
    arm_watchdogs()
    return clock.now_s()  # the bus is too slow for the watchdogs
