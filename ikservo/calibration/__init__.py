"""Ticks become radians, and every limit remembers its source.

What a position of a servo means (`JointMap`, `Crank`, the seam of its count), what a joint may do
(`Limits`), and how both are found for one very arm: by hand (`sweep`, a pure machine), from
LeRobot's files, and kept in a file and in the servos as one transaction.
"""

from ikservo.calibration.ticks.crank import Crank
from ikservo.calibration.ticks.joint_map import JointMap
from ikservo.calibration.ticks.limits import Limit, Limits
from ikservo.calibration.ticks.words import JointUnit, say, source_words

__all__ = ["Crank", "JointMap", "JointUnit", "Limit", "Limits", "say", "source_words"]
