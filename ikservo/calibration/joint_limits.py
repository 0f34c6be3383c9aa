"""Joint limits with their sources, and checks for joints near or at a limit."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ikservo.calibration.joint_map import JointUnit, format_position
from ikservo.errors import CalibrationError

MIN_RANGE_TICKS = 50
"""Smallest range of a calibrated joint, ticks; with less travel, it counts as not moved."""

_NEAR = {"rad": math.radians(5.0), "m": 0.005}
_AT = {"rad": math.radians(0.3), "m": 0.0003}
_NEAR_FRACTION = 1 / 20  # for short ranges, because jaws would otherwise always be near a limit


@dataclass(frozen=True, slots=True)
class Limit:
    """One end of a joint's range.

    Attributes:
        value: The position in radians, or metres for a prismatic joint.
        source: The origin of the value, for messages: ``arm file``, ``servo register``,
            ``hand sweep of 2026-11-02``, ``user``.
    """

    value: float
    source: str


@dataclass(frozen=True, slots=True)
class Limits:
    """The range of one joint; intersections keep the active limit with its source."""

    joint: str
    lower: Limit
    upper: Limit
    unit: JointUnit = "rad"

    def __post_init__(self) -> None:
        if not self.lower.value <= self.upper.value:
            raise CalibrationError(
                f"{self.joint}: the range is empty, from {self._format_limit(self.lower)} "
                f"to {self._format_limit(self.upper)}.",
                "One of the two limits is wrong; calibrate this joint again.",
            )

    @classmethod
    def of(
        cls, joint: str, lower: float, upper: float, source: str, unit: JointUnit = "rad"
    ) -> Limits:
        """Return limits with the same source at both ends."""
        return cls(joint, Limit(lower, source), Limit(upper, source), unit)

    def intersect(self, other: Limits) -> Limits:
        """Return the range inside both limits; of two equal ends, the first keeps its source.

        Raises:
            CalibrationError: The intersection is empty; the error names both limits.
        """
        lower = max(self.lower, other.lower, key=lambda limit: limit.value)
        upper = min(self.upper, other.upper, key=lambda limit: limit.value)
        return Limits(self.joint, lower, upper, self.unit)

    def contains(self, value: float) -> bool:
        """Check whether a joint position [rad or m] is inside the limits."""
        return self.lower.value <= value <= self.upper.value

    @property
    def source(self) -> str:
        """The source of both ends, or both sources when they differ."""
        low, high = self.lower.source, self.upper.source
        return low if low == high else f"{low} / {high}"

    def _format_limit(self, limit: Limit) -> str:
        return f"{format_position(limit.value, self.unit)} ({limit.source})"


def limit_distance(position: float, lower: float, upper: float) -> float:
    """Compute the distance to the nearer limit; negative outside, infinite if there is no limit."""
    return min(position - lower, upper - position)


def near_distance(lower: float, upper: float, unit: str) -> float:
    """Compute the distance, rad or m, within which a joint counts as near a limit."""
    return min(_NEAR[unit], _NEAR_FRACTION * (upper - lower))


def at_distance(lower: float, upper: float, unit: str) -> float:
    """Compute the distance within which a joint counts as at a limit; see ``near_distance``."""
    return min(_AT[unit], near_distance(lower, upper, unit))


def near_limit(position: float, lower: float, upper: float, unit: str = "rad") -> bool:
    """Check whether a joint is within 5° (5 mm), or 1/20 of its range if less, of a limit."""
    return limit_distance(position, lower, upper) <= near_distance(lower, upper, unit)
