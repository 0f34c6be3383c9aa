"""Calibration of an arm: tick conversion, limits with their sources, and stored results.

This package contains the conversion of servo positions (`JointMap`, `Crank`, encoder wrap-around),
joint `Limits`, LeRobot's files, and the transaction that writes a calibration to file and servos.
"""

from ikservo.calibration.joint_limits import Limit, Limits
from ikservo.calibration.joint_map import Crank, JointMap, JointUnit, format_position, format_source

__all__ = ["Crank", "JointMap", "JointUnit", "Limit", "Limits", "format_position", "format_source"]
