"""The options of motions: what each means, its unit and its default."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import InitVar, dataclass
from typing import TypedDict, cast

from numpy.typing import ArrayLike

from ikservo.arm.arguments import check_callable
from ikservo.arm.reports import OnProgress
from ikservo.arm.tool_orientation import KEEP_BEST_EFFORT, ToolOrientation, check_orientation

__all__ = [
    "FollowOptions",
    "GripperOptions",
    "JointOptions",
    "MotionSettings",
    "PlanOptions",
    "PlanThroughOptions",
    "PointOptions",
    "ThroughOptions",
    "check_options",
    "parse_options",
]


class PlanOptions(TypedDict, total=False):
    """Options of ``plan_to`` and ``plan_line``; see ``PointOptions``."""

    speed: str
    stance: ToolOrientation
    orientation: ArrayLike | None


class PlanThroughOptions(PlanOptions, total=False):
    """Options of ``plan_through``; see ``ThroughOptions``."""

    blend_m: float
    line: bool


class FollowOptions(TypedDict, total=False):
    """Options of ``follow`` and ``follow_arm``; see ``PointOptions``."""

    speed: str
    on_progress: OnProgress | None


class JointOptions(TypedDict, total=False):
    """Options of ``move_joints``, ``pose`` and ``replay``; see ``PointOptions``."""

    speed: str
    on_progress: OnProgress | None


class PointOptions(PlanOptions, total=False):
    """Options of ``move_to`` and ``move_line``.

    Attributes:
        speed: The speed class of the arm file: slow, normal or fast; default normal. The first
            motion after torque comes on is slow.
        stance: The orientation of the tool at the end. By default the arm keeps the present one as
            well as it can.
        orientation: The whole orientation R_base_tip (3, 3) instead; default None. Arms with fewer
            than six joints have it at few points; they take a direction or a pitch.
        on_progress: Called with a ``MotionProgress`` in every control cycle, in the thread that
            moves the arm; default None.
    """

    on_progress: OnProgress | None


class ThroughOptions(PlanThroughOptions, total=False):
    """Options of ``move_through``: those of ``PointOptions``, and how the points are passed.

    The orientation is that at the last point.

    Attributes:
        blend_m: Within which distance the tip passes each point but the last; default 0.02 m.
        line: Whether the tip moves on straight lines, else the joints do; default False.
    """

    on_progress: OnProgress | None


class GripperOptions(TypedDict, total=False):
    """Options of ``gripper``.

    Attributes:
        width_m: The distance between the jaws, metres, instead of open or close; default None.
        force: The fraction of the servo's torque that it may use, to 1; default 0.3. The least is
            what overcomes the friction of its gears: 0.05, of an STS3215 for 7.4 V 0.1.
        on_progress: As in ``PointOptions``.
    """

    width_m: float | None
    force: float | None
    on_progress: OnProgress | None


@dataclass(frozen=True, slots=True, eq=False)
class MotionSettings:
    """The options of a motion of the tip or of joints, checked, with the defaults.

    ``stance`` has the whole orientation, where that was given.
    """

    speed: str = "normal"
    stance: ToolOrientation = KEEP_BEST_EFFORT
    orientation: InitVar[ArrayLike | None] = None
    on_progress: OnProgress | None = None
    blend_m: float = 0.02
    line: bool = False

    def __post_init__(self, orientation: ArrayLike | None) -> None:
        check_callable("on_progress", self.on_progress)
        object.__setattr__(self, "stance", check_orientation(self.stance, orientation))


_WITH_WAIT = (PointOptions, ThroughOptions, JointOptions, GripperOptions)


def parse_options(method: str, known: type, options: Mapping[str, object]) -> MotionSettings:
    """Return the options that a method of ``Arm`` was given, and the defaults of the others.

    Args:
        method: Its name.
        known: The TypedDict of its options.
        options: Those given.

    Raises:
        TypeError: One is unknown; suggests the closest.
        BadValueError: The callback cannot be called, or the orientation is none or given twice.
    """
    check_options(method, known, options)
    return MotionSettings(**cast("ThroughOptions", options))


def check_options(method: str, known: type, options: Mapping[str, object]) -> None:
    """Refuse an option that a method does not have, as Python does for a parameter.

    Raises:
        TypeError: There is one; suggests the closest.
    """
    names = [*known.__annotations__, *(["wait"] if known in _WITH_WAIT else [])]
    for name in options.keys() - known.__annotations__.keys():
        close = difflib.get_close_matches(name, names, n=1)
        hint = f"Did you mean '{close[0]}'?" if close else f"Options: {', '.join(names)}."
        raise TypeError(f"Arm.{method}() got an unexpected keyword argument '{name}'. {hint}")
