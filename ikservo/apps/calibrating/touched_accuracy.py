"""Pose accuracy measured by hand: the tip is put on known points, and the arm says where it is."""

from __future__ import annotations

from collections.abc import Sequence

from ikservo.apps.calibrating.kinematic_calibration import TouchPoint
from ikservo.apps.lab.accuracy_test import PoseResult
from ikservo.kinematics import Chain

__all__ = ["touched_poses"]


def touched_poses(chain: Chain, touches: Sequence[TouchPoint]) -> list[PoseResult]:
    """Return where the tip was by the arm's joints while it was on known points.

    What bends, has play or is calibrated wrongly is in these, besides the accuracy of the hand.

    Args:
        chain: The arm as calibrated.
        touches: Of points whose positions are known.
    """
    found: dict[str, PoseResult] = {}
    for touch in touches:
        if touch.position_m is not None:
            pose = found.setdefault(touch.point, PoseResult(touch.point, touch.position_m))
            pose.attained_m.append(chain.forward(touch.q)[:3, 3])
    return list(found.values())
