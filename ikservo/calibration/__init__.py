"""Ticks become radians, and every limit remembers its source."""

from ikservo.calibration.joint_map import JointMap
from ikservo.calibration.limits import Limit, Limits
from ikservo.calibration.words import JointUnit, say

__all__ = ["JointMap", "JointUnit", "Limit", "Limits", "say"]
