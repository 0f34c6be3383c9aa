"""Joint positions as every command prints them: one a line, degrees for turns, mm for slides."""

from __future__ import annotations

from collections.abc import Mapping

from ikservo.calibration import JointUnit, say

__all__ = ["joint_lines"]


def joint_lines(positions: Mapping[str, tuple[float, JointUnit]]) -> list[str]:
    """Return a line for each joint, from its position [rad or m] and unit by name."""
    words = {name: say(at, unit) for name, (at, unit) in positions.items()}
    name_width = max(map(len, words), default=0)
    width = max(map(len, words.values()), default=0)
    return [f"{name:{name_width}}  {word:>{width}}" for name, word in words.items()]
