"""Ticks become radians, and every limit remembers its source."""

from ikservo.calibration.joint_map import JointMap
from ikservo.calibration.limits import Limit, Limits

__all__ = ["JointMap", "Limit", "Limits"]
