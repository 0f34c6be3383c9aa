"""``arm.pick`` and ``arm.place``: pick something up, and put it down somewhere else."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass
from typing import Annotated, Any, cast

import numpy as np
from numpy.typing import ArrayLike

from ikservo.apps.grasping.grasp_planner import GraspPlanner, Motions, Stance
from ikservo.arm.arm_parts import ArmParts
from ikservo.arm.arm_protocol import OpenArm
from ikservo.arm.own_motion import OwnMotion
from ikservo.arm.run_by_kind import run_motion
from ikservo.errors import BadValueError, NotSettledError, RefusedError, format_point
from ikservo.ik.problem import check_position
from ikservo.kinematics.arrays import Matrix, Vector, finite_vector
from ikservo.kinematics.se3 import make_pose, rotation_rpy
from ikservo.model.scene_file import KeepOutShape
from ikservo.planning.context import ArmContext
from ikservo.planning.motion_plan import MotionPlan
from ikservo.planning.motions import MoveGripper, Speed
from ikservo.planning.reports import GraspResult, OnProgress
from ikservo.planning.tool_orientation import ToolOrientation

_PITCHES_RAD = np.radians([-86.0, -80.0, -75.0, -60.0, -45.0, -30.0, -15.0, 0.0])
_CLEARANCE_M, _LEAST_M = 0.006, 0.001  # between the thing and each jaw: wanted, and needed
_RAISES_M = (0.0, 0.003, 0.006, 0.01, 0.015)
_DROPS_M = (0.002, 0.006, 0.01, 0.015, 0.02)
_UNKNOWN_M, _TOP_M = 0.03, 0.004  # width of something of unknown size; part of a thing above jaws
_ASKEW_RAD = math.radians(15.0)  # largest angle of the jaws to the horizontal, and to the thing
_UPRIGHT_RAD = math.radians(2.0)


def _parse_point(value: object) -> tuple[float, ...]:
    return tuple(check_position(cast("ArrayLike", value), "The point").tolist())


def _parse_size(value: object) -> tuple[float, ...]:
    size_m = finite_vector(cast("ArrayLike", value), 3, "The size").tolist()
    if min(size_m) <= 0.0:
        raise BadValueError("The size", str(size_m), "three lengths above 0 m")
    return tuple(size_m)


@dataclass(slots=True)
class Grip:
    """How the gripper holds what ``pick`` has picked up.

    Attributes:
        T_thing_tip: The pose of the tip (4, 4) at the upright thing; None if it is not known.
        height_m: The height of the thing.
    """

    T_thing_tip: Matrix | None = None
    height_m: float = 0.0


def grip_of(_arm: OpenArm) -> Grip:
    """Return the grip of an arm that has just been opened."""
    return Grip()


class Grasping(OwnMotion[GraspResult]):
    """Motions that are all planned before the first one."""

    @abstractmethod
    def plan(
        self, context: ArmContext, start: Vector, grip: Grip | None = None
    ) -> tuple[Motions, MotionPlan]:
        """Return all motions from the joints ``start`` (n,), and one plan of them.

        Raises:
            RefusedError: It is not possible; the message says why.
            UnreachableError: The point is out of reach.
        """

    def end(self, context: ArmContext, start: Vector) -> Vector:
        """Compute the joints (n,) after the motion from ``start`` (n,); nothing moves."""
        return self.plan(context, start)[1].goal


@dataclass(frozen=True)
class Pick(Grasping):
    """The jaws open, approach a thing, close on it and lift it.

    Attributes:
        middle_m: The middle (3,) of what is gripped, metres, base frame.
        size_m: Its length, width and height (3,); None if unknown: then the jaws close in any
            direction, with their middle at the very point.
        yaw_rad: The direction of its length, from x towards y.
        speed: See ``MoveTo``.
    """

    middle_m: Annotated[Any, _parse_point]
    _: KW_ONLY
    size_m: Annotated[Any, _parse_size] = None
    yaw_rad: float = 0.0
    speed: Speed = "normal"

    def plan(
        self, context: ArmContext, start: Vector, grip: Grip | None = None
    ) -> tuple[Motions, MotionPlan]:
        """Plan the motions: jaws open, above, down, close, up, press again."""
        planner, middle_m = GraspPlanner(context, start, self.speed), np.array(self.middle_m)
        most_m, raises_m = planner.jaws.most_m, [0.0]
        sides: list[tuple[float, float | None]] = [(_UNKNOWN_M, None)]
        if self.size_m is not None:
            length_m, width_m, height_m = self.size_m
            raises_m += [each for each in _RAISES_M[1:] if each <= height_m / 2.0 - _TOP_M]
            across = (width_m, self.yaw_rad + math.pi / 2.0), (length_m, self.yaw_rad)
            # Jaws that cannot be turned to a thing turn the thing.
            sides = [*sorted(across), (math.hypot(length_m, width_m), None)]
        if sides[0][0] + 2.0 * _LEAST_M > most_m:
            wide_mm, most_mm = 1000.0 * sides[0][0], 1000.0 * most_m
            raise RefusedError(
                f"The thing is {wide_mm:.0f} mm wide, the jaws open {most_mm:.0f} mm there.",
                "Nothing moves. Choose a narrower thing.",
            )

        def stances() -> Iterator[Stance]:
            for pitch_rad in _PITCHES_RAD.tolist():
                T = planner.tip_at(middle_m, ToolOrientation(pitch_rad), np.zeros(3))
                for across_m, side_rad in sides:
                    spare_m = min(2.0 * _CLEARANCE_M, most_m - across_m)
                    if T is None or spare_m < 2.0 * _LEAST_M:
                        continue
                    rolls = planner.level_rolls(T[:3, :3], pitch_rad, side_rad, _ASKEW_RAD)
                    grip_m = planner.jaws.at_width(across_m + spare_m)[1]
                    yield from ((ToolOrientation(pitch_rad, each), grip_m) for each in rolls)

        opening, close = MoveGripper("open"), MoveGripper("close")
        closed = planner.jaws.at_width(sides[0][0])[0]
        return planner.plan(
            middle_m,
            raises_m,
            stances(),
            lambda above, down, away: [opening, above, down, close, away, close],
            closed,
        )

    def run(self, arm: ArmParts, on_progress: OnProgress | None) -> GraspResult:
        """Plan everything, then pick it up; jaws that find nothing open again.

        Raises:
            RefusedError: It is not possible, and nothing moved; or the gripper found nothing.
        """
        motions, _ = self.plan(arm.context, arm.runner.start_position())
        report = _run(arm, motions[:4], on_progress)
        T_base_tip = arm.context.planner.tip_pose(arm.context.servos.measure_positions())
        if not report.grasped:
            _run(arm, (motions[0], motions[4]), on_progress)
        elif (report := _run(arm, motions[4:], on_progress)).grasped:
            if self.size_m is not None:
                T = make_pose(np.array(self.middle_m), rotation_rpy(0.0, 0.0, self.yaw_rad))
                grip = cast("Any", arm).grip
                grip.T_thing_tip, grip.height_m = np.linalg.inv(T) @ T_base_tip, self.size_m[2]
            return report
        at = format_point(self.middle_m)
        raise RefusedError(
            f"The gripper found nothing at {at}, or lost it.", "Look, then try again."
        )

    def __str__(self) -> str:
        return f"pick up at {format_point(self.middle_m)}"


@dataclass(frozen=True)
class Place(Grasping):
    """The arm puts down what its gripper holds, opens the jaws and withdraws.

    Attributes:
        middle_m: The point (3,) for the middle of what it holds, metres, base frame.
        speed: See ``MoveTo``.
    """

    middle_m: Annotated[Any, _parse_point]
    _: KW_ONLY
    speed: Speed = "normal"

    def plan(
        self, context: ArmContext, start: Vector, grip: Grip | None = None
    ) -> tuple[Motions, MotionPlan]:
        """Plan the motions: above, press again, down, open, up."""
        planner, T = GraspPlanner(context, start, self.speed), context.planner.tip_pose(start)
        known = None if grip is None else grip.T_thing_tip
        R = (T if known is None else known)[:3, :3]
        heading_rad = math.atan2(T[1, 3], T[0, 3])
        pitch_rad, roll_rad = planner.tool.pitch_rad(R), planner.tool.roll_rad(R, heading_rad)
        stance = ToolOrientation(pitch_rad, roll_rad, within_rad=_UPRIGHT_RAD)
        grip_m = planner.jaws.at_width(_UNKNOWN_M)[1] if known is None else -R.T @ known[:3, 3]
        return planner.plan(
            np.array(self.middle_m),
            _DROPS_M,
            [(stance, grip_m)],
            lambda to, down, away: [to, MoveGripper("close"), down, MoveGripper("open"), away],
            float(start[context.index.outside_chain()][0]),
        )

    def run(self, arm: ArmParts, on_progress: OnProgress | None) -> GraspResult:
        """Plan everything, then put it down.

        Raises:
            RefusedError: It is not possible, and nothing moved; or the gripper holds nothing.
        """
        grip: Grip = cast("Any", arm).grip
        motions, _ = self.plan(arm.context, arm.runner.start_position(), grip)
        is_held, grip.T_thing_tip = _run(arm, motions[:2], on_progress).grasped, None
        if not is_held:
            raise RefusedError("The gripper holds nothing.", "Pick something up first.")
        return _run(arm, motions[2:], on_progress)

    def __str__(self) -> str:
        return f"put down at {format_point(self.middle_m)}"


def pick(arm: OpenArm, thing: ArrayLike | KeepOutShape, **options: Any) -> GraspResult:  # noqa: ANN401
    """Pick up a block of ``arm.camera``, or what is at a point (3,) [m]; options: see ``Pick``.

    Raises:
        RefusedError: It is too wide or below the table, no grasp is possible, or none was found.
        UnreachableError: It is out of reach; nothing moved.
    """
    return arm.execute(pick_of(thing, **options))


def pick_of(thing: ArrayLike | KeepOutShape, **options: Any) -> Pick:  # noqa: ANN401
    """Return the motion that picks up an upright box, or what is at a point (3,) [m]."""
    if not isinstance(thing, KeepOutShape):
        return Pick(thing, **options)
    yaw_rad = math.atan2(thing.row[3], thing.row[0])
    return Pick(thing.row[9:12], size_m=2.0 * thing.half_size_m, yaw_rad=yaw_rad, **options)


def place(arm: OpenArm, middle_m: ArrayLike, *, speed: str = "normal") -> GraspResult:
    """Put down what the gripper holds, with its middle at a point (3,) [m]; see ``Place``.

    Raises:
        RefusedError: It is below the table, the way is not free, or the gripper holds nothing.
        UnreachableError: It is out of reach; nothing moved.
    """
    return arm.execute(Place(middle_m, speed=speed))


def _run(arm: ArmParts, motions: Motions, on_progress: OnProgress | None) -> GraspResult:
    """Make motions, and return the last report of the jaws; these find what is near enough."""
    found: object = None
    for motion in motions:
        with suppress(NotSettledError):
            report = run_motion(arm, motion, on_progress)
            found = report if isinstance(report, GraspResult) else found
    return cast("GraspResult", found)
