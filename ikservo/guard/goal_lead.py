"""The lead that a goal may have over the measured position of its joint."""

from __future__ import annotations

import math

MAX_TRAVEL_RAD = 60 * math.tau / 4096
"""Allowed travel of a horn after the program that moves it has died [rad]: 60 ticks of 4096."""

# Largest lead of a goal over a moving joint, without the steady-state error of a P-controlled servo
# under load, and without the lead that compensates this error.
_LEAD_TIME_S = 0.1  # time at the joint's top speed
_AT_REST_LEAD_RAD = 0.12  # at the horn: lead of a joint at rest that suits any joint
_MAX_AT_REST_LEAD_RAD = 0.2  # at the horn: the largest lead at rest that an arm file gives a joint


def at_rest_lead_rad(lifting_lag_rad: float) -> float:
    """Compute the allowed lead of a goal at rest from the lag of a horn that lifts the payload."""
    return min(max(lifting_lag_rad, _AT_REST_LEAD_RAD), _MAX_AT_REST_LEAD_RAD)


def moving_lead_rad(horn_rad_s: float) -> float:
    """Compute the lead that a goal over a moving horn may have in addition to the lead at rest."""
    return min(horn_rad_s * _LEAD_TIME_S, MAX_TRAVEL_RAD)
