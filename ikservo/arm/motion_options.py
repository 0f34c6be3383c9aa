"""The options that the motions of an arm share, for the types of their two ways to be called."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypedDict

from numpy.typing import ArrayLike

from ikservo.arm.reports import MotionProgress
from ikservo.arm.tool_orientation import ToolOrientation

__all__ = ["JointOptions", "OnProgress", "PointOptions", "ThroughOptions"]

OnProgress = Callable[[MotionProgress], None]
"""Called in every control cycle, in the thread that moves the arm."""


class JointOptions(TypedDict, total=False):
    """Of a motion of joints."""

    speed: str
    on_progress: OnProgress | None


class PointOptions(JointOptions, total=False):
    """Of a motion of the tip to a point."""

    stance: ToolOrientation
    orientation: ArrayLike | None


class ThroughOptions(PointOptions, total=False):
    """Of a motion of the tip through several points."""

    blend_m: float
    line: bool
