"""Getting up: an arm that lies folded goes to a pose where it stands free, and on from there."""

from __future__ import annotations

from dataclasses import replace

from ikservo.arm.planning.plan import Plan
from ikservo.motion import Sequel

__all__ = ["RISEN", "risen"]

RISEN = ("home", "rest")
"""The poses that are tried, in this order; every arm file has them."""


def risen(first: Plan, then: Plan, pose: str) -> Plan:
    """Return a plan that goes to a pose first, rests there, and goes on from it.

    Args:
        first: To the pose.
        then: From the pose.
        pose: Its name.
    """
    return replace(
        then,
        start=first.start,
        course=Sequel(first.course, then.course),
        path_m=first.path_m + then.path_m,
        duration_s=first.duration_s + then.duration_s,
        setters=tuple(dict.fromkeys(first.setters + then.setters)),
        by=pose,
    )
