"""Measure pose accuracy by hand: the tip is put on known points, and the joints are read."""

from __future__ import annotations

from collections.abc import Iterable

from ikservo.apps.lab.accuracy_test import PoseResult
from ikservo.kinematics.arrays import Vector


def touched_poses(tips: Iterable[tuple[str, Vector, Vector]]) -> list[PoseResult]:
    """Group touches of known points; errors include those of backlash, bending and hand.

    Args:
        tips: Name, position (3,) and tip (3,) of each touched point; metres, base frame.
    """
    found: dict[str, PoseResult] = {}
    for name, point_m, tip_m in tips:
        found.setdefault(name, PoseResult(name, point_m)).attained_m.append(tip_m)
    return list(found.values())
