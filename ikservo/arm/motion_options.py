"""The options of motions: what each means, its unit and its default."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from dataclasses import InitVar, dataclass
from typing import TypedDict, cast

from numpy.typing import ArrayLike

from ikservo.arm.arguments import check_callable, parse_number
from ikservo.arm.reports import OnProgress
from ikservo.arm.tool_orientation import KEEP_BEST_EFFORT, ToolOrientation, check_orientation
from ikservo.errors import BadValueError

__all__ = [
    "ArcOptions",
    "DrawOptions",
    "FollowOptions",
    "GripperOptions",
    "JointOptions",
    "LineOptions",
    "MotionSettings",
    "PlanArcOptions",
    "PlanDrawOptions",
    "PlanLineOptions",
    "PlanOptions",
    "PlanThroughOptions",
    "PointOptions",
    "ThroughOptions",
    "check_options",
    "parse_options",
]


class PlanOptions(TypedDict, total=False):
    """Options of ``plan_to``; see ``PointOptions``."""

    speed: str
    stance: ToolOrientation
    orientation: ArrayLike | None


class PlanLineOptions(PlanOptions, total=False):
    """Options of ``plan_line``; see ``LineOptions``."""

    tool_speed_m_s: float | None


class PlanArcOptions(PlanLineOptions, total=False):
    """Options of ``plan_arc``; see ``ArcOptions``."""

    full_circle: bool
    center_m: ArrayLike | None
    normal: ArrayLike
    angle_rad: float


class PlanDrawOptions(PlanLineOptions, total=False):
    """Options of ``plan_drawing``; see ``DrawOptions``."""

    lift_m: float


class PlanThroughOptions(PlanLineOptions, total=False):
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
    """Options of ``move_to``.

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


class LineOptions(PlanLineOptions, total=False):
    """Options of ``move_line``: those of ``PointOptions``, and the speed of the tool.

    Attributes:
        tool_speed_m_s: The speed of the tip, constant but for the ramps at both ends, as far as
            the joints and the speed class (0.1, 0.25 or 0.5 m/s) allow; the plan's ``tool_speed``
            says what is reached. Default None: the fastest.
    """

    on_progress: OnProgress | None


class ArcOptions(PlanArcOptions, total=False):
    """Options of ``move_arc``: those of ``LineOptions``, and circles.

    Attributes:
        full_circle: Whether the circle through the tip, the via point and the end is closed;
            default False.
        center_m: The centre (3,) [m] of a circle about which the tip goes, instead of a via point
            and an end; default None.
        normal: The direction (3,) of that circle's axis, against which it is counter-clockwise;
            default (0, 0, 1).
        angle_rad: How far the tip goes about it, negative for clockwise; default 2π.
    """

    on_progress: OnProgress | None


class DrawOptions(PlanDrawOptions, total=False):
    """Options of ``draw``: those of ``LineOptions``, and how the tip gets from stroke to stroke.

    The tool speed is that along a stroke.

    Attributes:
        lift_m: How far above a stroke the tip goes before the first, between two and after the
            last; default 0.01 m.
    """

    on_progress: OnProgress | None


class ThroughOptions(PlanThroughOptions, total=False):
    """Options of ``move_through``: those of ``LineOptions``, and how the points are passed.

    The orientation is that at the last point.

    Attributes:
        blend_m: Within which distance the tip passes each point but the last; default 0.02 m.
        line: Whether the tip moves on straight lines, else the joints do; default False. Only on
            lines the tool has a speed.
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
    tool_speed_m_s: float | None = None
    full_circle: bool = False
    center_m: ArrayLike | None = None
    normal: ArrayLike = (0.0, 0.0, 1.0)
    angle_rad: float = math.tau
    lift_m: float = 0.01

    def __post_init__(self, orientation: ArrayLike | None) -> None:
        if self.tool_speed_m_s is not None:
            speed = parse_number("The speed of the tool", self.tool_speed_m_s)
            if not 0.0 < speed < math.inf:
                raise BadValueError("The speed of the tool", f"{speed:g} m/s", "more than 0 m/s")
        check_callable("on_progress", self.on_progress)
        object.__setattr__(self, "stance", check_orientation(self.stance, orientation))


class _AllOptions(ThroughOptions, ArcOptions, DrawOptions, total=False): ...


_WITH_WAIT = (
    PointOptions,
    LineOptions,
    ArcOptions,
    DrawOptions,
    ThroughOptions,
    JointOptions,
    GripperOptions,
)


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
    return MotionSettings(**cast("_AllOptions", options))


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
