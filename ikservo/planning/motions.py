"""Motions as values: all requests to an arm, and their form in JSON and TOML.

A motion is frozen and checked when it is created; points are metres in the arm's base frame. It
is planned by ``Arm.plan``, executed by ``Arm.execute``, and started in the background by
``Arm.start``. The methods of ``Arm`` (``move_to``, ``gripper``, …) build it from their arguments.

In JSON or TOML, a motion is a table with one key, its kind; fields with default values are left
out::

    {"move_line": {"position_m": [0.25, 0.05, 0.15], "tool_speed_m_s": 0.05}}
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, MISSING, dataclass, fields, is_dataclass, replace
from functools import cache, partial
from typing import Annotated, Any, ClassVar, Generic, TypeVar, cast, get_args, get_type_hints

import numpy as np
from numpy.typing import ArrayLike

from ikservo.app_discovery import all_apps, load_place
from ikservo.arguments import (
    check_choice,
    check_flag,
    parse_joint_positions,
    parse_name,
    parse_number,
    parse_points,
)
from ikservo.errors import BadValueError, InputError, UnknownNameError, format_point, shown
from ikservo.ik import Posture
from ikservo.ik.problem import check_position
from ikservo.kinematics.arrays import Vector, finite_vector, finite_vectors
from ikservo.motion import ToolPath, straight_lines
from ikservo.planning.path_constraint import UNCONSTRAINED, PathConstraint
from ikservo.planning.reports import GraspResult, JointMoveResult, MoveResult
from ikservo.planning.tool_orientation import KEEP_BEST_EFFORT, ToolOrientation, check_orientation

SPEEDS = ("slow", "normal", "fast")
"""The speed classes in every arm file."""

R = TypeVar("R")
Point = tuple[float, float, float]

THINK_S = 3.0
"""Default time to search for a path around obstacles [s]."""

_MAX_WAIT_S = 3600.0
_PLAIN = (str, bool, float, tuple)
_SHOWN = 100  # characters of a value in an error


def _vector(what: str) -> Callable[[object], Point]:
    return lambda value: tuple(finite_vector(cast("ArrayLike", value), 3, what).tolist())


def _target(what: str) -> Callable[[object], Point]:
    return lambda value: tuple(check_position(cast("ArrayLike", value), what).tolist())


def _number(what: str) -> Callable[[object], float]:
    return lambda value: parse_number(what, value)


def _flag(what: str) -> Callable[[object], bool]:
    return lambda value: check_flag(what, value)


def _choice(what: str, choices: Sequence[str]) -> Callable[[object], str]:
    return lambda value: check_choice(
        what, value if isinstance(value, str) else shown(value), choices
    )


def _above_zero(what: str, unit: str, expected: str) -> Callable[[object], float]:
    def parse(value: object) -> float:
        number = parse_number(what, value)
        if not 0.0 < number < math.inf:
            raise BadValueError(what, f"{number:g} {unit}", expected)
        return number

    return parse


def _parse_targets(values: object) -> tuple[Point, ...]:
    return tuple(map(_target("The target position"), parse_points(values)))


def _parse_strokes(values: object) -> tuple[tuple[Point, ...], ...]:
    strokes = [finite_vectors(each, 3, "A stroke of the drawing") for each in parse_points(values)]
    return tuple(tuple((x, y, z) for x, y, z in each.reshape(-1, 3).tolist()) for each in strokes)


def _parse_constraint(value: object) -> PathConstraint:
    if not isinstance(value, PathConstraint):
        raise BadValueError(
            "within", shown(value), "a PathConstraint, such as PathConstraint(upright_rad=0.2)"
        )
    return value


# Fields of several motions. The parser of a field is part of its type, here or in a motion.
TargetPoint = Annotated[ArrayLike, _target("The target position")]
ToolSpeed = Annotated[
    float | None, _above_zero("The speed of the tool", "m/s", "a speed above 0 m/s")
]
Speed = Annotated[str, _choice("speed", SPEEDS)]
Stance = Annotated[ToolOrientation, check_orientation]
Straight = Annotated[bool, _flag("straight")]
Within = Annotated[PathConstraint, _parse_constraint]
Think = Annotated[float, _above_zero("The time to search for a path", "s", "more than 0 s")]
Replan = Annotated[bool, _flag("replan")]


@dataclass(frozen=True)
class MotionValue(Generic[R]):
    """Base class of all kinds of motions; ``R`` is the type of the result.

    Attributes:
        kind: The name of the kind in JSON and TOML, such as ``move_to``.
        starts_at_tip: Whether the path begins at the present tip, so that a folded arm cannot
            unfold first.
    """

    kind: ClassVar[str]
    starts_at_tip: ClassVar[bool] = False

    def __init_subclass__(cls) -> None:
        cls.kind = re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).lower()

    def __post_init__(self) -> None:
        parsers = _parsers_of(type(self))
        for each in fields(cast("type[Any]", type(self))):
            value = getattr(self, each.name)
            if not (value is None and each.default is None):
                object.__setattr__(self, each.name, parsers[each.name](value))
        self._check()

    @property
    def has_speed(self) -> bool:
        """Whether the motion has a speed class."""
        return hasattr(self, "speed")

    def with_speed(self, speed: str) -> MotionValue[R]:
        """Return the motion at a speed class (slow, normal, fast), if it has one."""
        return replace(self, speed=speed) if self.has_speed else self  # pyright: ignore[reportCallIssue]

    def _check(self) -> None:
        """Refuse fields that contradict each other."""

    def __str__(self) -> str:
        """Return a short description."""
        return self.kind.replace("_", " ")


@cache
def _parsers_of(kind: type[MotionValue[Any]]) -> Mapping[str, Callable[[object], object]]:
    """Return the parsers of a motion's fields, which are part of the field types."""
    hints = get_type_hints(kind, include_extras=True)
    names = [each.name for each in fields(cast("Any", kind))]
    return {name: _parser_of(f"{kind.__name__}.{name}", name, hints[name]) for name in names}


def _parser_of(place: str, name: str, hint: Any) -> Callable[[object], object]:  # noqa: ANN401
    """Return a field's parser: from ``Annotated[type, parse]``, or the parser of the plain type."""
    if hasattr(hint, "__metadata__"):
        return hint.__metadata__[0]
    if hint not in (bool, int, float, str):
        raise TypeError(
            f"{place} needs an annotated type with a parser, such as Annotated[list, parse]."
        )

    def parse(value: object) -> object:
        accepted = (int, float) if hint is float else hint
        if not isinstance(value, accepted) or (isinstance(value, bool) and hint is not bool):
            raise BadValueError(name, shown(value), f"a value of type {hint.__name__}")
        return value

    return parse


@dataclass(frozen=True)
class MoveTo(MotionValue[MoveResult]):
    """Motion of the tip to a point, by the fastest motion of the joints.

    Attributes:
        position_m: The point (3,), metres, base frame.
        speed: The speed class of the arm file: slow, normal or fast. The first motion after torque
            comes on is slow.
        stance: The orientation of the tool at the end. By default, the arm keeps the present
            orientation as well as it can.
        straight: Whether the joint path must be straight; otherwise, it may avoid obstacles.
        within: The constraint of the tool during the whole motion.
        think_s: Time after which the search for a path around obstacles gives up, s. If it is
            longer than ``THINK_S``, the rest is used to shorten the path.
        replan: Whether the arm continues on another path if an obstacle enters its path. It stops
            in front of the obstacle in any case.
    """

    position_m: TargetPoint
    _: KW_ONLY
    speed: Speed = "normal"
    stance: Stance = KEEP_BEST_EFFORT
    straight: Straight = False
    within: Within = UNCONSTRAINED
    think_s: Think = THINK_S
    replan: Replan = False

    def __str__(self) -> str:
        return f"joints to {_format_point(self.position_m)}"


@dataclass(frozen=True)
class MoveLine(MotionValue[MoveResult]):
    """Motion of the tip on a straight line to a point; the tool rotates uniformly.

    Attributes:
        position_m: The point (3,), metres, base frame.
        tool_speed_m_s: The tip speed, constant except for the ramps at both ends, if the joints and
            the speed class (0.1, 0.25 or 0.5 m/s) allow it; the plan's ``tool_speed`` contains the
            speed that is reached. None means as fast as possible.
        speed: See ``MoveTo``.
        stance: See ``MoveTo``.
        within: See ``MoveTo``.
    """

    position_m: TargetPoint
    _: KW_ONLY
    tool_speed_m_s: ToolSpeed = None
    speed: Speed = "normal"
    stance: Stance = KEEP_BEST_EFFORT
    within: Within = UNCONSTRAINED

    def path_from(self, tip_m: Vector) -> ToolPath:
        """Return the path from the present tip (3,) [m]."""
        return straight_lines(tip_m, [self.position_m])

    def __str__(self) -> str:
        return f"line to {_format_point(self.position_m)}"


@dataclass(frozen=True)
class MoveArc(MotionValue[MoveResult]):
    """Motion of the tip on an arc: through a point to an end, or about a centre.

    Attributes:
        via_m: A point (3,) [m] that the arc passes.
        end_m: The end (3,) [m] of the arc.
        full_circle: Whether the circle through the tip, the via point and the end is closed.
        center_m: The centre (3,) [m] of the arc, instead of a via point and an end.
        normal: The direction (3,) of the axis, about which the arc runs counter-clockwise.
        angle_rad: The angle of the arc, negative for clockwise.
        tool_speed_m_s: See ``MoveLine``.
        speed: See ``MoveTo``.
        stance: See ``MoveTo``.
        within: See ``MoveTo``.

    Raises:
        BadValueError: Both a via point with an end and a centre are given, or neither is.
    """

    starts_at_tip = True

    via_m: Annotated[ArrayLike | None, _vector("The via point of the arc")] = None
    end_m: Annotated[ArrayLike | None, _vector("The end of the arc")] = None
    _: KW_ONLY
    full_circle: Annotated[bool, _flag("full_circle")] = False
    center_m: Annotated[ArrayLike | None, _vector("The centre of the circle")] = None
    normal: Annotated[ArrayLike, _vector("The normal of the circle")] = (0.0, 0.0, 1.0)
    angle_rad: Annotated[float, _number("The angle of the arc")] = math.tau
    tool_speed_m_s: ToolSpeed = None
    speed: Speed = "normal"
    stance: Stance = KEEP_BEST_EFFORT
    within: Within = UNCONSTRAINED

    def _check(self) -> None:
        given = {"a via point": self.via_m, "an end": self.end_m, "a centre": self.center_m}
        names = [name for name, value in given.items() if value is not None]
        through_points = names == ["a via point", "an end"]
        about_axis = names == ["a centre"] and not self.full_circle
        if not (through_points or about_axis):
            raise BadValueError(
                "The arc",
                f"given by {' and '.join(names) or 'nothing'}",
                "a via point and an end, or a centre alone",
            )

    def path_from(self, tip_m: Vector) -> ToolPath:
        """Return the path from the present tip (3,) [m]."""
        from ikservo.motion.arc import arc_about_axis, arc_through_points  # noqa: PLC0415

        if self.center_m is not None:
            return arc_about_axis(tip_m, self.center_m, self.normal, self.angle_rad)
        via_m, end_m = cast("Any", self.via_m), cast("Any", self.end_m)
        return arc_through_points(tip_m, via_m, end_m, full_circle=self.full_circle)

    def __str__(self) -> str:
        if self.center_m is not None:
            angle_deg = math.degrees(self.angle_rad)
            return f"arc of {angle_deg:.0f}° about {_format_point(self.center_m)}"
        end_m = _format_point(cast("Point", self.end_m))
        return f"{'circle' if self.full_circle else 'arc'} to {end_m}"


@dataclass(frozen=True)
class MoveThrough(MotionValue[MoveResult]):
    """Motion of the tip through points without stopping; the tip rests at the last point.

    Attributes:
        points_m: The points (k, 3), metres, base frame.
        blend_m: Distance within which the tip passes each point except the last.
        line: Whether the tip moves on straight lines; otherwise, the joints move point to point.
        tool_speed_m_s: The tip speed, only on lines; see ``MoveLine``.
        speed: See ``MoveTo``.
        stance: The stance at the last point; see ``MoveTo``.
        within: See ``MoveTo``.
    """

    points_m: Annotated[Iterable[ArrayLike], _parse_targets]
    _: KW_ONLY
    blend_m: Annotated[float, _number("The blend")] = 0.02
    line: Annotated[bool, _flag("line")] = False
    tool_speed_m_s: ToolSpeed = None
    speed: Speed = "normal"
    stance: Stance = KEEP_BEST_EFFORT
    within: Within = UNCONSTRAINED

    def _check(self) -> None:
        if not self.points_m:
            raise BadValueError("The list of points", "empty", "at least one point")
        if not 0.0 < self.blend_m < math.inf:
            raise BadValueError("The blend", f"{self.blend_m} m", "a positive distance")
        if self.tool_speed_m_s is not None and not self.line:
            raise InputError(
                "A joint motion has no tool speed.",
                "Move in straight lines, or choose a speed class: slow, normal or fast.",
            )

    def path_from(self, tip_m: Vector) -> ToolPath:
        """Return the lines from the present tip (3,) [m], with rounded corners."""
        return straight_lines(tip_m, list(self.points_m), self.blend_m)

    def __str__(self) -> str:
        points = cast("tuple[Point, ...]", self.points_m)
        path = "lines" if self.line else "joints"
        return f"{path} through {len(points)} points to {_format_point(points[-1])}"


@dataclass(frozen=True)
class Draw(MotionValue[MoveResult]):
    """Motion of the tip along strokes; between strokes, the tip is lifted.

    Attributes:
        strokes_m: The points (k, 3) of each stroke, metres, base frame.
        lift_m: The height of the tip above the drawing before the first stroke, between strokes,
            and after the last.
        tool_speed_m_s: The tip speed along a stroke; see ``MoveLine``.
        speed: See ``MoveTo``.
        stance: See ``MoveTo``.
        within: See ``MoveTo``.
    """

    strokes_m: Annotated[Iterable[ArrayLike], _parse_strokes]
    _: KW_ONLY
    lift_m: Annotated[float, _number("The lift of the tool")] = 0.01
    tool_speed_m_s: ToolSpeed = None
    speed: Speed = "normal"
    stance: Stance = KEEP_BEST_EFFORT
    within: Within = UNCONSTRAINED

    def _check(self) -> None:
        if not self.strokes_m or not all(cast("tuple[tuple[Point, ...], ...]", self.strokes_m)):
            raise BadValueError("The drawing", "empty", "at least one stroke with a point")
        if not 0.0 <= self.lift_m < math.inf:
            raise BadValueError("The lift of the tool", f"{self.lift_m:g} m", "0 m or more")

    def __str__(self) -> str:
        count = len(cast("tuple[object, ...]", self.strokes_m))
        return f"drawing of {count} stroke{'s' if count > 1 else ''}"


TipMotion = MoveTo | MoveLine | MoveArc | MoveThrough | Draw
"""The motions of the tip; if a motion has ``path_from``, the planner gets its path from there."""


@dataclass(frozen=True)
class MoveJoints(MotionValue[JointMoveResult]):
    """Motion of some joints; the other joints keep their positions.

    Attributes:
        positions: The goals by joint, rad or m.
        speed: See ``MoveTo``.
        straight: See ``MoveTo``; if a joint of the chain is not named, the path is always straight.
        within: See ``MoveTo``.
        think_s: See ``MoveTo``.
        replan: See ``MoveTo``.
    """

    positions: Annotated[Mapping[str, float], parse_joint_positions]
    _: KW_ONLY
    speed: Speed = "normal"
    straight: Straight = False
    within: Within = UNCONSTRAINED
    think_s: Think = THINK_S
    replan: Replan = False

    def __hash__(self) -> int:
        """Return the hash of the items, because a mapping is not hashable."""
        others = [getattr(self, each.name) for each in fields(self) if each.name != "positions"]
        return hash((tuple(self.positions.items()), *others))

    def __str__(self) -> str:
        return ", ".join(f"{name} {value:.4g}" for name, value in self.positions.items())


@dataclass(frozen=True)
class MovePose(MotionValue[JointMoveResult]):
    """Joint motion to a pose that is clamped to the limits.

    Attributes:
        name: The name of a pose in the arm file, or of a taught pose.
        speed: See ``MoveTo``.
        straight: See ``MoveTo``.
        within: See ``MoveTo``.
        think_s: See ``MoveTo``.
        replan: See ``MoveTo``.
    """

    name: Annotated[str, partial(parse_name, "The name of the pose")]
    _: KW_ONLY
    speed: Speed = "normal"
    straight: Straight = False
    within: Within = UNCONSTRAINED
    think_s: Think = THINK_S
    replan: Replan = False

    def __str__(self) -> str:
        return f"pose {self.name}"


@dataclass(frozen=True)
class MoveToRest(MotionValue[JointMoveResult]):
    """Slow joint motion to the rest pose, through another pose if necessary."""


@dataclass(frozen=True)
class LookAt(MotionValue[JointMoveResult]):
    """Motion that points the tool axis at a point, for cameras and pan-tilts; the tip may move.

    Attributes:
        point_m: The point (3,), metres, base frame.
        speed: See ``MoveTo``.
    """

    point_m: Annotated[ArrayLike, _target("The point to look at")]
    _: KW_ONLY
    speed: Speed = "normal"

    def __str__(self) -> str:
        return f"look at {_format_point(self.point_m)}"


@dataclass(frozen=True)
class Lower(MotionValue[JointMoveResult]):
    """Slow joint motion to the rest pose, or as far towards it as the path is free."""


@dataclass(frozen=True)
class MoveGripper(MotionValue[GraspResult]):
    """Motion that opens or closes the jaws or moves them to a width; they stop at an object.

    Attributes:
        to: open or close; None if a width is given.
        width_m: The distance between the jaws, metres.
        force: Fraction of its torque that the servo may use, up to 1; None means 0.3. The minimum,
            which overcomes the friction of the gears, is 0.05, or 0.1 for a 7.4 V STS3215.
    """

    to: Annotated[str | None, _choice("gripper motion", ("open", "close"))] = None
    _: KW_ONLY
    width_m: Annotated[float | None, _number("The width")] = None
    force: Annotated[float | None, _number("The force")] = None

    def _check(self) -> None:
        if (self.to is None) == (self.width_m is None):
            raise InputError("Give the gripper exactly one of open, close and a width.")

    def __str__(self) -> str:
        return f"gripper {self.to if self.width_m is None else f'{self.width_m:g} m'}"


@dataclass(frozen=True)
class Wait(MotionValue[None]):
    """Pause during which the arm holds its position.

    Attributes:
        duration_s: The duration in seconds, above 0 and at most an hour.
    """

    duration_s: Annotated[float, _number("The wait")]

    def _check(self) -> None:
        if not 0.0 < self.duration_s <= _MAX_WAIT_S:
            raise BadValueError("The wait", f"{self.duration_s:g} s", "more than 0, at most 3600 s")

    def __str__(self) -> str:
        return f"wait {self.duration_s:g} s"


KINDS: Mapping[str, type[MotionValue[Any]]] = {
    each.kind: each
    for each in get_args(
        TipMotion | (MoveJoints | MovePose | LookAt | MoveToRest | Lower | MoveGripper | Wait)
    )
}
"""The kinds of motions in the core, by their names in JSON and TOML."""


def motion_names() -> list[str]:
    """Return the names of all kinds of motions in JSON and TOML, including those of apps."""
    return [*KINDS, *(name for app in all_apps() for name in app.motions)]


def motion_kind(name: str) -> type[MotionValue[Any]]:
    """Return the kind of motion with a name.

    Raises:
        UnknownNameError: There is no such kind.
    """
    if name in KINDS:
        return KINDS[name]
    for app in all_apps():
        if name in app.motions:
            return cast("type[MotionValue[Any]]", load_place(app.motions[name]))
    raise UnknownNameError("motion", name, motion_names())


def check_motion(motion: MotionValue[R]) -> MotionValue[R]:
    """Check that a value is a motion, and return it.

    Raises:
        BadValueError: The value is not a motion.
    """
    if not isinstance(cast("object", motion), MotionValue):
        raise BadValueError(
            "The motion", shown(motion), "a motion such as MoveTo((0.25, 0.0, 0.15))"
        )
    return motion


def motion_fields(motion: MotionValue[Any]) -> dict[str, dict[str, Any]]:
    """Return a motion as JSON values: its kind, and the fields that differ from their default."""
    return {motion.kind: _fields_of(motion)}


def parse_motion(value: object) -> MotionValue[Any]:
    """Parse a motion from the JSON values of ``motion_fields``.

    Raises:
        InputError: The value is not a table of one known kind, or a field is missing, unknown, or
            refused by the motion itself, with the same error as for a program.
    """
    is_table = isinstance(value, Mapping)
    table = dict(cast("Mapping[object, object]", value)) if is_table else {}
    if len(table) != 1:
        raise BadValueError(
            "The motion", _shorten(value), f"a table with one key: {', '.join(motion_names())}"
        )
    ((kind, fields_of_kind),) = table.items()
    kind = str(check_choice("motion", kind, motion_names()))
    return cast("MotionValue[Any]", _from_fields(kind, motion_kind(kind), fields_of_kind))


def _fields_of(value: Any) -> dict[str, Any]:  # noqa: ANN401  # a dataclass
    found: dict[str, Any] = {}
    for each in fields(value):
        at, default = getattr(value, each.name), cast("object", each.default)
        if at is None or at is default or (isinstance(default, _PLAIN) and at == default):
            continue
        found[each.name] = _fields_of(at) if is_dataclass(at) else _as_json(at)
    return found


def _as_json(value: object) -> object:
    if isinstance(value, Mapping):
        return dict(cast("Mapping[object, object]", value))
    if isinstance(value, np.ndarray):
        return cast("object", value.tolist())
    if isinstance(value, tuple):
        return [_as_json(each) for each in cast("tuple[object, ...]", value)]
    return value


def _shorten(value: object) -> str:
    text = repr(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}…"


def _from_fields(what: str, kind: Callable[..., object], given: object) -> object:
    """Make a dataclass from its fields as JSON values."""
    if not isinstance(given, Mapping):
        raise BadValueError(what, _shorten(given), "a table of its fields")
    values = in_american(cast("Mapping[str, object]", given))
    known = fields(cast("type[Any]", kind))
    names = [each.name for each in known]
    for name in values:
        if name not in names:
            close = difflib.get_close_matches(str(name), names, n=1)
            hint = f"Did you mean {close[0]}? " if close else ""
            listed = ", ".join(names) or "none"
            raise InputError(f"{what} has no field {str(name)!r}.", f"{hint}Fields: {listed}.")
    for each in known:
        if each.name not in values and each.default is MISSING:
            raise InputError(f"{what} lacks the field {each.name}.", f"Fields: {', '.join(names)}.")
    for name, nested in _NESTED.items():
        if values.get(name) is not None and name in names:
            values[name] = _from_fields(name, nested, values[name])
    return kind(**values)


def in_american(given: Mapping[str, R]) -> dict[str, R]:
    """Return fields or options by their American names; British spelling is also accepted."""
    return {"center_m" if name == "centre_m" else name: value for name, value in given.items()}


_NESTED: Mapping[str, Callable[..., object]] = {
    "stance": ToolOrientation,
    "posture": Posture,
    "within": PathConstraint,
}
"""The fields whose values are dataclasses, each with its class."""


def _format_point(point_m: ArrayLike) -> str:
    return format_point(cast("Point", point_m))
