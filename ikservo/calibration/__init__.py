"""Ticks become radians, and every limit remembers its source.

What a position of a servo means (`JointMap`, `Crank`, the seam of its count), what a joint may do
(`Limits`), and how both are found for one very arm: by hand (`sweep`, a pure machine), from
LeRobot's files, and kept in a file and in the servos as one transaction.
"""

from ikservo.calibration.joint_map import Crank, JointMap, JointUnit, format_position, source_words
from ikservo.calibration.limits import Limit, Limits

__all__ = ["Crank", "JointMap", "JointUnit", "Limit", "Limits", "format_position", "source_words"]
