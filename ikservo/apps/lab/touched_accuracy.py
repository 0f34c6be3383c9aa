"""Pose accuracy measured by hand: the tip is put on known points, and the arm says where it is."""

from __future__ import annotations

from collections.abc import Iterable

from ikservo.apps.lab.accuracy_test import PoseResult
from ikservo.kinematics.arrays import Vector


def touched_poses(tips: Iterable[tuple[str, Vector, Vector]]) -> list[PoseResult]:
    """Group touches of known points: they contain backlash, bending, and the error of the hand.

    Args:
        tips: For each touch its point's name, the point (3,), and the tip (3,); metres, base frame.
    """
    found: dict[str, PoseResult] = {}
    for name, point_m, tip_m in tips:
        found.setdefault(name, PoseResult(name, point_m)).attained_m.append(tip_m)
    return list(found.values())
