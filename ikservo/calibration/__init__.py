"""Calibration of an arm: tick conversion, limits with their sources, and stored results.

Contains the conversion of servo positions (`JointMap`, `Crank`, encoder wrap-around), joint
`Limits`, calibration by hand (a pure state machine), LeRobot's files, and storage in a file and in
the servos as one transaction.
"""

from ikservo.calibration.joint_limits import Limit, Limits
from ikservo.calibration.joint_map import Crank, JointMap, JointUnit, format_position, format_source

__all__ = ["Crank", "JointMap", "JointUnit", "Limit", "Limits", "format_position", "format_source"]
