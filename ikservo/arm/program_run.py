"""Programs checked and run: each step is planned from where the step before it ends."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from ikservo.arm import goal_motions
from ikservo.arm.arm_parts import ArmParts
from ikservo.arm.context import ArmContext
from ikservo.arm.gripper import GraspResult, move_gripper, plan_gripper
from ikservo.arm.motion_options import JointOptions, MotionSettings
from ikservo.arm.plan import MotionPlan
from ikservo.arm.poses import PoseLibrary
from ikservo.arm.preflight import PreflightPlanner
from ikservo.arm.program import Program, ProgramStep
from ikservo.arm.replay import ReplayResult, plan_replay, replay_recording
from ikservo.arm.reports import JointMoveResult, MoveResult, OnProgress
from ikservo.errors import BadValueError, IkservoError
from ikservo.kinematics.arrays import Vector

__all__ = ["ProgramRun", "StepCheck", "StepResult"]

_LONGEST_SLEEP_S = 0.05  # a wait notices a stop within this time


@dataclass(frozen=True, slots=True)
class StepCheck:
    """What the check of a program says of one step.

    Attributes:
        number: Of the step, from 1.
        step: The step.
        error: Why it cannot be made; None where it can.
    """

    number: int
    step: ProgramStep
    error: IkservoError | None


@dataclass(frozen=True, slots=True)
class StepResult:
    """A step that was made.

    Attributes:
        number: Of the step, from 1.
        repetition: Of the program, from 1.
        step: The step.
        report: Of its motion; None for a wait.
    """

    number: int
    repetition: int
    step: ProgramStep
    report: MoveResult | JointMoveResult | GraspResult | ReplayResult | None


class _PlannedStart:
    """The end of the step before, as the start of the next one."""

    def __init__(self, joints: Vector) -> None:
        self.joints = joints

    def start_position(self) -> Vector:
        """Return the planned joints (n,)."""
        return self.joints

    def allowed_speed(self, speed: str) -> str:
        """Return the requested speed class: paths do not depend on it."""
        return speed

    def enable(self) -> None:
        """Do nothing: a check moves nothing."""


class ProgramRun:
    """A program on one arm: checked, then made as a whole, from a step on, or step by step.

    Args:
        arm: The arm.
        program: Its steps.
        folder: The program's, in which its recordings are.
        poses: The poses of the arm.
        on_wait: Called now and then during a wait.

    Raises:
        BadValueError: It is another arm's program.
    """

    def __init__(
        self,
        arm: ArmParts,
        program: Program,
        folder: Path,
        poses: PoseLibrary,
        on_wait: Callable[[], object] | None = None,
    ) -> None:
        name = arm.context.model.name
        if program.arm != name:
            raise BadValueError("The program", f"one for {program.arm}", f"one for {name}")
        self._arm, self._program, self._folder, self._poses = arm, program, folder, poses
        self._on_wait = on_wait
        self._has_moved = False  # before that torque may be off

    def check(self, first: int = 1) -> Iterator[StepCheck]:
        """Plan each step from where the one before it ends; nothing moves.

        The first one starts where the arm is. With ``repeat`` the first step is checked from the
        end of the last one as well. After a step that cannot be made it goes on from where the arm
        would be without it.

        Args:
            first: The step to begin with, from 1.

        Raises:
            BadValueError: There is no such step.
            CalibrationError: The arm is not calibrated.
        """
        begin = self._index_of(first)
        self._arm.context.require_zeros()
        start = _PlannedStart(self._arm.runner.start_position())
        numbers = list(range(begin, len(self._program.steps)))
        if self._program.repeat > 1:
            numbers += range(begin + 1)
        for index in numbers:
            step = self._program.steps[index]
            error = self._find_error(step, start)
            yield StepCheck(index + 1, step, error)

    def run(self, first: int = 1, on_progress: OnProgress | None = None) -> Iterator[StepResult]:
        """Make the steps, one with each value that is taken from the iterator.

        Args:
            first: The step to begin with, from 1; repetitions begin with the first of all.
            on_progress: Called in every control cycle.

        Raises:
            BadValueError: There is no such step.
            IkservoError: A step failed; the arm holds where it is. See ``Arm``.
        """
        begin, stop_count = self._index_of(first), self._arm.background.stop_count
        for repetition in range(1, self._program.repeat + 1):
            for index in range(begin, len(self._program.steps)):
                step = self._program.steps[index]
                with self._arm.background.requested(stop_count):
                    result = self._make(step, on_progress)
                yield StepResult(index + 1, repetition, step, result)
            begin = 0

    def _index_of(self, number: int) -> int:
        count = len(self._program.steps)
        if not 1 <= number <= count:
            raise BadValueError("The step", number, f"1 to {count}")
        return number - 1

    def _find_error(self, step: ProgramStep, start: _PlannedStart) -> IkservoError | None:
        try:
            start.joints = self._plan(step, start)
        except IkservoError as error:
            return error
        return None

    def _plan(self, step: ProgramStep, start: _PlannedStart) -> Vector:
        """Return the joints (n,) after a step."""
        context, speed = self._arm.context, self._program.speed_of(step)
        preflight = PreflightPlanner(context, start, self._poses)
        match step.action:
            case "wait_s":
                return start.joints
            case "gripper":
                return plan_gripper(context, step.gripper or 0.0, start.joints)
            case "recording":
                return plan_replay(self._arm, self._file(step), speed, start.joints)
            case "tip_m":
                return _plan_tip(preflight, step, speed).goal
            case "pose":
                inside = preflight.pose_within_limits(step.pose or "", start.joints)
                return preflight.plan_joints(inside.positions, speed).goal
            case _:
                return preflight.plan_joints(_positions(context, step), speed).goal

    def _make(
        self, step: ProgramStep, on_progress: OnProgress | None
    ) -> MoveResult | JointMoveResult | GraspResult | ReplayResult | None:
        options = JointOptions(speed=self._program.speed_of(step), on_progress=on_progress)
        match step.action:
            case "wait_s":
                self._wait(step.wait_s or 0.0)
                return None
            case _:
                self._has_moved = True
                return self._move(step, options, on_progress)

    def _move(
        self, step: ProgramStep, options: JointOptions, on_progress: OnProgress | None
    ) -> MoveResult | JointMoveResult | GraspResult | ReplayResult:
        arm = self._arm
        match step.action:
            case "gripper":
                return move_gripper(arm, step.gripper, on_progress=on_progress)
            case "recording":
                return replay_recording(arm, self._file(step), **options)
            case "tip_m":
                return _move_tip(arm, step, options)
            case "pose":
                return goal_motions.pose(arm, step.pose or "", **options)
            case _:
                return goal_motions.move_joints(arm, _positions(arm.context, step), **options)

    def _wait(self, seconds: float) -> None:
        """Wait while the arm holds; a stop or a fault of a servo ends it.

        Raises:
            StoppedError, RefusedError: The arm was stopped.
            BusError: A servo does not answer.
            ServoAlarmError: One reports a fault, has a wrong supply, or was reset.
        """
        context = self._arm.context
        end_s = context.now_s() + seconds
        while (left_s := end_s - context.now_s()) > 0.0:
            context.servos.check_stop()
            context.servos.stop_request.check_request()
            if self._has_moved:
                context.servos.check_health()
            if self._on_wait is not None:
                self._on_wait()
            context.servos.clock.sleep_until(context.now_s() + min(left_s, _LONGEST_SLEEP_S))

    def _file(self, step: ProgramStep) -> Path:
        return self._folder / (step.recording or "")


def _plan_tip(preflight: PreflightPlanner, step: ProgramStep, speed: str) -> MotionPlan:
    settings = MotionSettings(speed=speed, tool_speed_m_s=step.tool_speed_m_s)
    match step.path:
        case "arc":
            return preflight.plan_arc(step.via_m, step.tip_m, settings)
        case "line":
            return preflight.plan_line(step.tip_m or (), settings)
        case _:
            return preflight.plan_to(step.tip_m or (), settings)


def _move_tip(arm: ArmParts, step: ProgramStep, options: JointOptions) -> MoveResult:
    tip_m = step.tip_m or ()
    match step.path:
        case "arc":
            return goal_motions.move_arc(
                arm, step.via_m, tip_m, tool_speed_m_s=step.tool_speed_m_s, **options
            )
        case "line":
            return goal_motions.move_line(arm, tip_m, tool_speed_m_s=step.tool_speed_m_s, **options)
        case _:
            return goal_motions.move_to(arm, tip_m, **options)


def _positions(context: ArmContext, step: ProgramStep) -> dict[str, float]:
    """Return the positions of a step's joints, rad or m by name.

    Raises:
        BadValueError: A joint that turns is given in metres, or one that slides in degrees.
        UnknownNameError: There is no such joint.
    """
    for key, given in (("deg", step.deg), ("m", step.m)):
        for name in given:
            unit = context.model.joint(name).joint_map.unit
            if (unit == "m") != (key == "m"):
                raise BadValueError(name, f"given by {key}", "m" if unit == "m" else "deg")
    return {name: math.radians(value) for name, value in step.deg.items()} | dict(step.m)
