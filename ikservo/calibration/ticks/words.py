"""Joint positions as a person reads them: degrees for turns, millimetres for slides."""

from __future__ import annotations

import math
from typing import Literal

__all__ = ["JointUnit", "say"]

JointUnit = Literal["rad", "m"]


def say(position: float, unit: JointUnit) -> str:
    """Return ``101.3°`` for a position in rad, ``12.0 mm`` for one in m."""
    if unit == "m":
        return f"{position * 1000:z.1f} mm"
    return f"{math.degrees(position):z.1f}°"
