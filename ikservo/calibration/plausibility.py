"""Plausibility of the zeros that follow from the reference pose, against the arm file.

A joint's stops lie near the limits of the arm file. Where one end of the swept range is far
beyond its limit and the other end is not, the zero is shifted: the arm was not in the pose.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from ikservo.calibration.procedure import CalibrationState
from ikservo.calibration.range_tracker import JointUnderCalibration
from ikservo.calibration.result import measure_joint

__all__ = ["ShiftedZero", "find_shifted_zeros"]

_MAX_SHIFT_RAD = math.radians(10.0)
_MAX_SHIFT_M = 0.004


@dataclass(frozen=True, slots=True)
class ShiftedZero:
    """A joint whose zero seems to be shifted.

    Attributes:
        subject: The joint.
        ends: Its swept range, rad or m.
        shift: How far the range has to move to fit the arm file's best, rad or m.
    """

    subject: JointUnderCalibration
    ends: tuple[float, float]
    shift: float

    def __str__(self) -> str:
        say, expected = self.subject.joint_map.format, self.subject.expected
        return (
            f"{self.subject.name}: swept {' to '.join(map(say, self.ends))}, arm file "
            f"{say(expected.lower.value)} to {say(expected.upper.value)}: "
            f"the zero seems to be off by {say(abs(self.shift))}."
        )


def find_shifted_zeros(wizard: CalibrationState) -> Iterator[ShiftedZero]:
    """Yield the measured joints whose zero is implausible, once the sweep has ended.

    Raises:
        CalibrationError: A range that was known before does not hold the anchor pose.
    """
    for subject in wizard.subjects:
        ends = measure_joint(wizard, subject).range_inside_margin(0.0)
        if ends is None:
            continue
        above = ends[1] - subject.expected.upper.value
        below = subject.expected.lower.value - ends[0]
        shift = (above - below) / 2
        if min(max(above, below), abs(shift)) > _max_shift(subject):
            yield ShiftedZero(subject, ends, -shift)


def _max_shift(subject: JointUnderCalibration) -> float:
    return _MAX_SHIFT_RAD if subject.joint_map.unit == "rad" else _MAX_SHIFT_M
