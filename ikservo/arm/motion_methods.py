"""Methods that move an arm, plan or stop it; each builds a motion.

Both kinds of ``OpenArm`` (``arm_protocol``) share them: an arm on a port and an arm on another
machine. Each kind implements planning and execution itself.
"""

from __future__ import annotations

import difflib
from abc import abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any, Literal, Protocol, TypedDict, TypeVar, Unpack, cast, overload

from numpy.typing import ArrayLike

from ikservo.app_discovery import member_names, member_of_arms
from ikservo.arguments import OnExit, check_callable, check_flag, parse_all_positions
from ikservo.arm.background_motion import Background, RunningMotion
from ikservo.arm.method_options import with_options
from ikservo.control.stop_requests import STOPPED_BY_PROGRAM
from ikservo.errors import InputError, shown
from ikservo.guard import StopKind, StopReason
from ikservo.planning.motion_plan import MotionPlan
from ikservo.planning.motions import (
    THINK_S,
    Draw,
    LookAt,
    Lower,
    MotionValue,
    MoveArc,
    MoveGripper,
    MoveJoints,
    MoveLine,
    MovePose,
    MoveThrough,
    MoveTo,
    MoveToRest,
    check_motion,
    in_american,
)
from ikservo.planning.path_constraint import UNCONSTRAINED, PathConstraint
from ikservo.planning.reports import (
    GraspResult,
    JointMoveResult,
    MoveResult,
    OnProgress,
)
from ikservo.planning.tool_orientation import KEEP_BEST_EFFORT, ToolOrientation, check_orientation

R = TypeVar("R")

Positions = Mapping[str, float] | ArrayLike
"""Positions by joint name, or of all joints (n,), rad or m."""

Points = Iterable[ArrayLike]
"""Points (k, 3) [m] in the base frame."""

GripperCommand = Literal["open", "close"]

JawGoal = GripperCommand | float | None
"""The goal of the jaws: open, close, or the distance between them [m]."""


_PARTS = frozenset(
    [
        "background",
        "chain",
        "clock",
        "context",
        "follow_goals",
        "is_remote",
        "joint_index",
        "last_state",
        "leader_positions",
        "load_replay",
        "plan_lowering",
        "pose_within_limits",
        "preflight",
        "request_stop",
        "return_within_limits",
        "runner",
        "stop_requests",
        "target_period_s",
    ]
)
"""Attributes that only the package uses; ``dir`` of an arm omits them."""


class JointOptions(TypedDict, total=False):
    """Options of joint motions; planning methods do not accept ``on_progress``."""

    speed: str
    on_progress: OnProgress | None


class GoalOptions(JointOptions, total=False):
    """Options of ``move_joints`` and ``pose``; see ``MoveJoints``."""

    straight: bool
    within: PathConstraint
    think_s: float
    replan: bool


class TipOptions(JointOptions, total=False):
    """Options of every motion of the tip; see ``MoveTo``.

    ``orientation`` is the full orientation R_base_tip (3, 3) instead of a stance. Arms with fewer
    than six joints reach it at few points; for these, give a direction or a pitch.
    """

    stance: ToolOrientation
    orientation: ArrayLike | None
    within: PathConstraint


class PointOptions(TipOptions, total=False):
    """Options of ``move_to``; see ``MoveTo``."""

    straight: bool
    think_s: float
    replan: bool


class LineOptions(TipOptions, total=False):
    """Options of ``move_line``; see ``MoveLine``."""

    tool_speed_m_s: float | None


class ArcOptions(LineOptions, total=False):
    """Options of ``move_arc``; see ``MoveArc``."""

    full_circle: bool
    center_m: ArrayLike | None
    normal: ArrayLike
    angle_rad: float


class ThroughOptions(LineOptions, total=False):
    """Options of ``move_through``; see ``MoveThrough``."""

    blend_m: float
    line: bool


class DrawOptions(LineOptions, total=False):
    """Options of ``draw``; see ``Draw``."""

    lift_m: float


class GripperOptions(TypedDict, total=False):
    """Options of ``gripper``; see ``MoveGripper``."""

    width_m: float | None
    force: float | None
    on_progress: OnProgress | None


class MotionMethods(Protocol):
    """Methods that move, plan and stop; omitted options have their defaults.

    Methods that move the arm block until it is at rest. With ``wait=False`` the motion runs in the
    background, and they return a ``RunningMotion``. ``on_progress`` is called with a
    ``MotionProgress`` in every control cycle, in the thread that moves the arm.
    """

    background: Background
    _on_exit: OnExit

    def __dir__(self) -> list[str]:
        own = (name for name in super().__dir__() if name not in _PARTS)
        return sorted({*own, *member_names()})

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        self.close(self._on_exit if error is None else "hold")

    @abstractmethod
    def close(self, on_exit: OnExit | None = None) -> None:
        """Close the arm and leave it holding or relaxed; a second call does nothing."""

    @abstractmethod
    def enable(self) -> None:
        """Switch torque on without any motion."""

    def hold(self) -> None:
        """Hold the present position; another name for ``enable``."""
        self.enable()

    def stop(self, reason: str = "") -> None:
        """Brake the running motion within 0.3 s and hold; safe from signals and other threads.

        The motion ends with ``StoppedError``; nothing moves again before ``acknowledge``.
        """
        text = shown(reason, str) or STOPPED_BY_PROGRAM.text
        self.request_stop(StopReason(StopKind.PROGRAM, text))

    @abstractmethod
    def request_stop(self, reason: StopReason) -> None:
        """Stop the arm like ``stop``, with a reason of any kind."""

    @property
    @abstractmethod
    def stop_reason(self) -> StopReason | None:
        """The reason for the stop, until ``acknowledge``; None if the arm is not stopped."""

    @property
    def stopped_for(self) -> str:
        """The text of ``stop_reason``; empty if the arm is not stopped."""
        reason = self.stop_reason
        return "" if reason is None else reason.text

    @property
    @abstractmethod
    def joint_names(self) -> tuple[str, ...]:
        """Names of all joints, in the order used in vectors (n,)."""

    @abstractmethod
    def plan(self, motion: MotionValue[Any]) -> MotionPlan:
        """Plan a motion of the tip or of joints from the present position; nothing moves.

        Raises:
            UnreachableError: A point is out of reach.
            RefusedError: Something is in the way, or a joint would leave its limits.
            CalibrationError: The arm is not calibrated.
            BadValueError: The motion has no plan: a gripper motion, a replay or a wait.
        """

    @overload
    def execute(
        self, plan: MotionPlan, on_progress: OnProgress | None = None
    ) -> MoveResult | JointMoveResult: ...

    @overload
    def execute(self, plan: MotionValue[R], on_progress: OnProgress | None = None) -> R: ...

    def execute(
        self, plan: MotionPlan | MotionValue[Any], on_progress: OnProgress | None = None
    ) -> object:
        """Execute a plan or a motion, block until the arm is at rest, and return the result.

        A motion is planned from the position at which the arm holds after the motions before it.

        Returns:
            A ``MoveResult`` for a plan of the tip; a ``JointMoveResult`` of the moved joints for a
            plan of joints; the motion's own result for a motion.

        Raises:
            RefusedError: The arm has moved since the plan was made, or the guard stopped the
                motion.
        """
        check_callable("on_progress", on_progress)
        if not isinstance(plan, MotionValue):
            return self._execute_plan(plan, on_progress)
        own_stops = self._own_stops
        with self.background.turn():
            return self._make(plan, on_progress, own_stops)

    def start(
        self, motion: MotionValue[R], on_progress: OnProgress | None = None
    ) -> RunningMotion[R]:
        """Start a motion in the background, after those requested so far.

        The motion counts as requested now: a stop from now on ends it, even before it has started.
        """
        check_callable("on_progress", on_progress)
        check_motion(motion)
        return self.background.start(self._make, motion, on_progress, self._own_stops)

    @property
    def _own_stops(self) -> int:
        """The number of stops by this program that the machine with the servos may not know yet."""
        return 0

    @abstractmethod
    def _execute_plan(
        self, plan: MotionPlan, on_progress: OnProgress | None
    ) -> MoveResult | JointMoveResult:
        """Execute a plan of this arm."""

    @abstractmethod
    def _make(self, motion: MotionValue[R], on_progress: OnProgress | None, own_stops: int) -> R:
        """Execute a motion.

        The motion is refused if this program's stop count differs from ``own_stops``.
        """

    @overload
    def move_to(
        self, position_m: ArrayLike, *, wait: Literal[True] = True, **options: Unpack[PointOptions]
    ) -> MoveResult: ...

    @overload
    def move_to(
        self, position_m: ArrayLike, *, wait: Literal[False], **options: Unpack[PointOptions]
    ) -> RunningMotion[MoveResult]: ...

    @with_options(MoveTo, PointOptions, takes_point=True)
    def move_to(
        self, position_m: ArrayLike, *, wait: bool = True, **options: Unpack[PointOptions]
    ) -> MoveResult | RunningMotion[MoveResult]:
        """Move the tip to a point (3,) [m]; options: see ``MoveTo`` and ``PointOptions``.

        Raises:
            UnreachableError: No joint positions within the limits reach the point; nothing has
                moved.
            OrientationError: The tool cannot have the orientation there; nothing has moved.
            IkservoError: The errors of every motion; see ``Arm``.
        """
        return self._run(MoveTo, (position_m,), options, wait=wait)

    @overload
    def move_line(
        self, position_m: ArrayLike, *, wait: Literal[True] = True, **options: Unpack[LineOptions]
    ) -> MoveResult: ...

    @overload
    def move_line(
        self, position_m: ArrayLike, *, wait: Literal[False], **options: Unpack[LineOptions]
    ) -> RunningMotion[MoveResult]: ...

    @with_options(MoveLine, LineOptions, takes_point=True)
    def move_line(
        self, position_m: ArrayLike, *, wait: bool = True, **options: Unpack[LineOptions]
    ) -> MoveResult | RunningMotion[MoveResult]:
        """Move the tip to a point (3,) [m] on a straight line; options: see ``MoveLine``.

        Raises:
            UnreachableError: A point on the line is out of reach; nothing has moved. Other
                errors: see ``move_to``.
        """
        return self._run(MoveLine, (position_m,), options, wait=wait)

    @overload
    def move_arc(
        self,
        via_m: ArrayLike | None = None,
        end_m: ArrayLike | None = None,
        *,
        wait: Literal[True] = True,
        **options: Unpack[ArcOptions],
    ) -> MoveResult: ...

    @overload
    def move_arc(
        self,
        via_m: ArrayLike | None = None,
        end_m: ArrayLike | None = None,
        *,
        wait: Literal[False],
        **options: Unpack[ArcOptions],
    ) -> RunningMotion[MoveResult]: ...

    @with_options(MoveArc, ArcOptions)
    def move_arc(
        self,
        via_m: ArrayLike | None = None,
        end_m: ArrayLike | None = None,
        *,
        wait: bool = True,
        **options: Unpack[ArcOptions],
    ) -> MoveResult | RunningMotion[MoveResult]:
        """Move the tip on an arc through a point (3,) [m] to an end (3,), or on a circle.

        The arc begins at the present tip position. Options: see ``MoveArc``.

        Raises:
            BadValueError: The points are collinear, or the radius is zero; nothing has moved.
            UnreachableError: A point of the arc is out of reach; nothing has moved. Other
                errors: see ``move_to``.
        """
        return self._run(MoveArc, (via_m, end_m), options, wait=wait)

    @overload
    def move_through(
        self, points_m: Points, *, wait: Literal[True] = True, **options: Unpack[ThroughOptions]
    ) -> MoveResult: ...

    @overload
    def move_through(
        self, points_m: Points, *, wait: Literal[False], **options: Unpack[ThroughOptions]
    ) -> RunningMotion[MoveResult]: ...

    @with_options(MoveThrough, ThroughOptions)
    def move_through(
        self, points_m: Points, *, wait: bool = True, **options: Unpack[ThroughOptions]
    ) -> MoveResult | RunningMotion[MoveResult]:
        """Move the tip through points (k, 3) [m] without stopping; options: see ``MoveThrough``.

        Raises:
            UnreachableError: A point, or a line to it, is out of reach; nothing has moved. Other
                errors: see ``move_to``.
        """
        return self._run(MoveThrough, (points_m,), options, wait=wait)

    @overload
    def draw(
        self,
        strokes_m: Iterable[ArrayLike],
        *,
        wait: Literal[True] = True,
        **options: Unpack[DrawOptions],
    ) -> MoveResult: ...

    @overload
    def draw(
        self,
        strokes_m: Iterable[ArrayLike],
        *,
        wait: Literal[False],
        **options: Unpack[DrawOptions],
    ) -> RunningMotion[MoveResult]: ...

    @with_options(Draw, DrawOptions)
    def draw(
        self, strokes_m: Iterable[ArrayLike], *, wait: bool = True, **options: Unpack[DrawOptions]
    ) -> MoveResult | RunningMotion[MoveResult]:
        """Move the tip along strokes, each with points (k, 3) [m]; options: see ``Draw``.

        ``ikservo.read_drawing`` reads strokes from SVG and CSV files.

        Raises:
            UnreachableError: A point is out of reach; the error names the first such point. Nothing
                has moved. Other errors: see ``move_to``.
        """
        return self._run(Draw, (strokes_m,), options, wait=wait)

    @overload
    def move_joints(
        self,
        positions: Positions,
        *,
        wait: Literal[True] = True,
        **options: Unpack[GoalOptions],
    ) -> JointMoveResult: ...

    @overload
    def move_joints(
        self, positions: Positions, *, wait: Literal[False], **options: Unpack[GoalOptions]
    ) -> RunningMotion[JointMoveResult]: ...

    @with_options(MoveJoints, GoalOptions)
    def move_joints(
        self, positions: Positions, *, wait: bool = True, **options: Unpack[GoalOptions]
    ) -> JointMoveResult | RunningMotion[JointMoveResult]:
        """Move some joints, given by name [rad or m], or all joints (n,).

        Raises:
            UnknownNameError: There is no such joint.
            RefusedError: A position is outside the limits; nothing has moved. Other
                errors: see ``move_to``.
        """
        goals = parse_all_positions(positions, self.joint_names)
        return self._run(MoveJoints, (goals,), options, wait=wait)

    @overload
    def pose(
        self, name: str, *, wait: Literal[True] = True, **options: Unpack[GoalOptions]
    ) -> JointMoveResult: ...

    @overload
    def pose(
        self, name: str, *, wait: Literal[False], **options: Unpack[GoalOptions]
    ) -> RunningMotion[JointMoveResult]: ...

    @with_options(MovePose, GoalOptions)
    def pose(
        self, name: str, *, wait: bool = True, **options: Unpack[GoalOptions]
    ) -> JointMoveResult | RunningMotion[JointMoveResult]:
        """Move to a pose of the arm file, or to a taught pose, clamped to the limits.

        Returns:
            The result; ``binding`` names the joints that were clamped.

        Raises:
            UnknownNameError: There is no such pose; the closest name is suggested.
            RefusedError: The pose is outside this arm's limits, or something is in the way.
        """
        return self._run(MovePose, (name,), options, wait=wait)

    @overload
    def look_at(
        self, point_m: ArrayLike, *, wait: Literal[True] = True, **options: Unpack[JointOptions]
    ) -> JointMoveResult: ...

    @overload
    def look_at(
        self, point_m: ArrayLike, *, wait: Literal[False], **options: Unpack[JointOptions]
    ) -> RunningMotion[JointMoveResult]: ...

    @with_options(LookAt, JointOptions, takes_point=True)
    def look_at(
        self, point_m: ArrayLike, *, wait: bool = True, **options: Unpack[JointOptions]
    ) -> JointMoveResult | RunningMotion[JointMoveResult]:
        """Point the tool axis at a point (3,) [m]; the tip may move.

        Raises:
            AimError: The limits do not allow this direction; nothing has moved. Other
                errors: see ``move_to``.
        """
        return self._run(LookAt, (point_m,), options, wait=wait)

    @overload
    def gripper(
        self, to: JawGoal = None, *, wait: Literal[True] = True, **options: Unpack[GripperOptions]
    ) -> GraspResult: ...

    @overload
    def gripper(
        self, to: JawGoal = None, *, wait: Literal[False], **options: Unpack[GripperOptions]
    ) -> RunningMotion[GraspResult]: ...

    @with_options(MoveGripper, GripperOptions)
    def gripper(
        self, to: JawGoal = None, *, wait: bool = True, **options: Unpack[GripperOptions]
    ) -> GraspResult | RunningMotion[GraspResult]:
        """Open or close the gripper, or move its jaws to a width; options: see ``MoveGripper``.

        ``to`` is open, close, or a width [m] if the arm file has widths. If an object blocks the
        jaws, they stop and hold it with at most the given force.

        Raises:
            IkservoError: The arm has no gripper.
            RefusedError: A jaw would touch something; nothing has moved.
            InputError: The width is out of its range or unknown, or the force is not a fraction.
        """
        if to is not None and not isinstance(to, str):
            if options.get("width_m") is not None:
                raise InputError("Give the gripper exactly one of open, close and a width.")
            options["width_m"], to = to, None
        return self._run(MoveGripper, (to,), options, wait=wait)

    @with_options(MoveTo, PointOptions, takes_point=True)
    def plan_to(self, position_m: ArrayLike, **options: Unpack[PointOptions]) -> MotionPlan:
        """Plan a motion of the tip to a point (3,) [m]; see ``move_to``.

        Raises:
            UnreachableError: The point is out of reach; the error has the nearest point in reach.
        """
        return self.plan(MoveTo(position_m, **_fields(MoveTo, options)))

    @with_options(MoveLine, LineOptions, takes_point=True)
    def plan_line(self, position_m: ArrayLike, **options: Unpack[LineOptions]) -> MotionPlan:
        """Plan a straight line of the tip to a point (3,) [m]; see ``move_line``."""
        return self.plan(MoveLine(position_m, **_fields(MoveLine, options)))

    @with_options(MoveArc, ArcOptions)
    def plan_arc(
        self,
        via_m: ArrayLike | None = None,
        end_m: ArrayLike | None = None,
        **options: Unpack[ArcOptions],
    ) -> MotionPlan:
        """Plan an arc or a circle of the tip; see ``move_arc``."""
        return self.plan(MoveArc(via_m, end_m, **_fields(MoveArc, options)))

    @with_options(MoveThrough, ThroughOptions)
    def plan_through(self, points_m: Points, **options: Unpack[ThroughOptions]) -> MotionPlan:
        """Plan a motion through points (k, 3) [m] without stopping; see ``move_through``."""
        return self.plan(MoveThrough(points_m, **_fields(MoveThrough, options)))

    @with_options(Draw, DrawOptions)
    def plan_drawing(
        self, strokes_m: Iterable[ArrayLike], **options: Unpack[DrawOptions]
    ) -> MotionPlan:
        """Plan strokes of the tip, each with points (k, 3) [m]; see ``draw``."""
        return self.plan(Draw(strokes_m, **_fields(Draw, options)))

    def plan_joints(
        self,
        positions: Positions,
        *,
        speed: str = "normal",
        straight: bool = False,
        within: PathConstraint = UNCONSTRAINED,
        think_s: float = THINK_S,
        replan: bool = False,
    ) -> MotionPlan:
        """Plan a motion of some joints; see ``move_joints``."""
        goals = parse_all_positions(positions, self.joint_names)
        motion = MoveJoints(goals, speed=speed, straight=straight, within=within, think_s=think_s,
                            replan=replan)  # fmt: skip
        return self.plan(motion)

    def plan_look(self, point_m: ArrayLike, *, speed: str = "normal") -> MotionPlan:
        """Plan a motion after which the tool axis points at a point (3,) [m]; see ``look_at``."""
        return self.plan(LookAt(point_m, speed=speed))

    def plan_rest(self) -> MotionPlan:
        """Plan the slow motion to the rest pose, through another pose if necessary."""
        return self.plan(MoveToRest())

    def plan_lowering(self) -> MotionPlan:
        """Plan the slow motion to the rest pose, or only the part that is free of obstacles."""
        return self.plan(Lower())

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401  # whatever an app offers
        """Return a method or attribute that an app adds to open arms.

        Raises:
            AttributeError: No app adds this name.
        """
        return member_of_arms(self, name)

    def _run(
        self,
        kind: type[MotionValue[R]],
        goal: tuple[object, ...],
        options: Mapping[str, Any],
        *,
        wait: bool,
    ) -> R | RunningMotion[R]:
        """Make a motion of its goal and options; execute it, or start it in the background."""
        others = dict(options)
        on_progress = others.pop("on_progress", None)
        motion: MotionValue[R] = cast("Any", kind)(*goal, **_fields(kind, others))
        is_awaited = check_flag("wait", wait)
        return self.execute(motion, on_progress) if is_awaited else self.start(motion, on_progress)


def _fields(kind: type[MotionValue[Any]], options: Mapping[str, Any]) -> dict[str, Any]:
    """Return options as the fields of a motion; an orientation becomes part of the stance."""
    names = [each.name for each in fields(kind) if each.kw_only]
    names += ["orientation"] if "stance" in names else []
    options = in_american(options)
    for name in options.keys() - names:
        close = difflib.get_close_matches(name, [*names, "wait", "on_progress"], n=1)
        hint = f"Did you mean {close[0]!r}?" if close else f"Options: {', '.join(names)}."
        raise TypeError(f"{kind.kind}() got an unexpected keyword argument {name!r}. {hint}")
    given = dict(options)
    orientation = given.pop("orientation", None)
    if orientation is not None:
        given["stance"] = check_orientation(given.get("stance", KEEP_BEST_EFFORT), orientation)
    return given
