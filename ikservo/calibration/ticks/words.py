"""Joint positions as a person reads them: degrees for turns, millimetres for slides."""

from __future__ import annotations

import math
from typing import Literal

__all__ = ["JointUnit", "say", "source_words"]

JointUnit = Literal["rad", "m"]


def say(position: float, unit: JointUnit, digits: int = 1) -> str:
    """Return ``101.3°`` for a position in rad, ``12.0 mm`` for one in m."""
    if unit == "m":
        return f"{position * 1000:z.{digits}f} mm"
    return f"{math.degrees(position):z.{digits}f}°"


def source_words(source: str) -> str:
    """Return the source of a limit for a sentence: ``user`` becomes ``set by you``."""
    return " / ".join("set by you" if part == "user" else part for part in source.split(" / "))
