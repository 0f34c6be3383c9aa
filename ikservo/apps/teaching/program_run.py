"""Check and run programs: each step is planned from the end of the previous step."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ikservo.apps.teaching.program import UNTIL_STOPPED, Program, ProgramStep, read_program
from ikservo.apps.teaching.replaying import Replay, position_at_rest
from ikservo.arm.arm_protocol import ArmParts
from ikservo.arm.run_by_kind import end_of_motion, run_motion, wait
from ikservo.errors import BadValueError, IkservoError, InputError, StoppedError
from ikservo.planning.motions import MotionValue, Wait
from ikservo.planning.poses import PoseLibrary
from ikservo.planning.preflight_planner import PlannedStart, PreflightPlanner
from ikservo.planning.reports import (
    GraspResult,
    JointMoveResult,
    MoveResult,
    OnProgress,
    ReplayResult,
)

MAX_CHECKS = 5000
"""Largest number of steps in a check, including all places of grids and called programs."""

StepReport = MoveResult | JointMoveResult | GraspResult | ReplayResult
"""Report on the motion of a step."""


@dataclass(frozen=True, slots=True)
class StepCheck:
    """Result of checking a step, numbered from 1; it is possible if there is no error.

    The planned duration is NaN if only a run can show it.
    """

    number: int
    step: ProgramStep
    error: IkservoError | None
    duration_s: float


@dataclass(frozen=True, slots=True)
class NextStep:
    """A step that is to be run.

    Attributes:
        number: The number of the step, from 1; steps of a called program have the caller's number.
        repetition: The repetition of the whole program, from 1.
        step: The step, at its place of the grid.
        speed: The speed class.
        folder: The folder of its recording.
    """

    number: int
    repetition: int
    step: ProgramStep
    speed: str
    folder: Path


class ProgramRun:
    """A program on an arm: check it, then run its steps one by one.

    Args:
        arm: The arm.
        program: The program.
        folder: The folder that contains the program, its recordings and the programs that it calls.
        poses: The poses of the arm.
        on_wait: Called regularly during a wait.
        has_grasped: Whether the gripper is known to hold something already.

    Attributes:
        has_grasped: Whether the gripper found something when it last moved.

    Raises:
        InputError: The program, or one that it calls, is for another arm; or a called program
            calls another program, or is repeated until it is stopped.
        FileFormatError: A called program is malformed.
    """

    def __init__(
        self,
        arm: ArmParts,
        program: Program,
        folder: Path,
        poses: PoseLibrary,
        on_wait: Callable[[], object] | None = None,
        *,
        has_grasped: bool = False,
    ) -> None:
        self._arm, self._program, self._folder, self._poses = arm, program, folder, poses
        self._called = {
            step.program: read_program(folder / step.program)
            for step in program.steps
            if step.program is not None
        }
        name = arm.context.model.name
        for each in (program, *self._called.values()):
            if each.arm != name:
                raise BadValueError("The program", f"for {each.arm}", f"a program for {name}")
        for file, called in self._called.items():
            if called.repeat == UNTIL_STOPPED:
                raise InputError(f"{file} cannot be called, because it repeats until stopped.")
            if any(step.program for step in called.steps):
                raise InputError(f"{file} cannot be called, because it calls another program.")
        self._on_wait = on_wait
        self._stop_count = arm.background.stop_count
        self._has_moved = False  # torque may be off before the first motion
        self.has_grasped = has_grasped

    @property
    def pauses(self) -> bool:
        """Whether the program has a pause, which ends when a person continues."""
        programs = (self._program, *self._called.values())
        return any(step.pause is not None for each in programs for step in each.steps)

    def check(self, first: int = 1) -> Iterator[StepCheck]:
        """Plan each step from the end of the previous step; nothing moves.

        Step ``first``, counted from 1, starts at the present position. With ``repeat``, the first
        step is also checked from the end of the last one, and each place of a grid is checked.
        Steps with a condition are checked as if it were true. After an impossible step the check
        continues as if the program did not have that step.

        Raises:
            InputError: There is no such step, or there are too many to check.
            CalibrationError: The arm is not calibrated.
            StoppedError: A stop was requested.
        """
        begin = self._index_of(first)
        self._arm.context.require_zeros()
        start = PlannedStart(position_at_rest(self._arm))
        stop_count = self._arm.background.stop_count
        for count, each in enumerate(self._checked_steps(self._program, self._folder, begin)):
            if count >= MAX_CHECKS:
                raise InputError(
                    f"Counting repetitions, the program has more than {MAX_CHECKS} steps.",
                    "Use fewer steps or places.",
                )
            error: IkservoError | None = None
            duration_s = math.nan
            context = self._arm.context
            preflight = PreflightPlanner(context, start, self._poses)
            try:
                if each.step.pause is None:
                    with self._arm.background.requested(stop_count):
                        motion = self._motion(each)
                        start.joints, duration_s = end_of_motion(
                            context, preflight, motion, start.joints
                        )
            except StoppedError:
                raise
            except IkservoError as refused:
                error = refused
            yield StepCheck(each.number, each.step, error, duration_s)

    def _checked_steps(
        self, program: Program, folder: Path, begin: int, caller: int | None = None
    ) -> Iterator[NextStep]:
        """Yield each step from index ``begin`` on, once for each place at which it can end."""
        places = max((s.grid.rows * s.grid.columns for s in program.steps if s.grid), default=1)
        count = len(program.steps)
        rounds = [(1, range(begin, count))]
        rounds += [(n, range(count)) for n in range(2, int(min(places, program.repetitions)) + 1)]
        if program.repetitions > len(rounds):
            rounds.append((len(rounds) + 1, range(begin + 1)))
        for repetition, indices in rounds:
            for index in indices:
                step, number = program.steps[index], caller or index + 1
                if step.program is not None:
                    called, path = self._called[step.program], folder / step.program
                    yield from self._checked_steps(called, path.parent, 0, number)
                else:
                    at = step.at_repetition(repetition)
                    yield NextStep(number, repetition, at, program.speed_of(step), folder)

    def steps(self, first: int = 1, repetition: int = 1) -> Iterator[NextStep]:
        """Yield the steps to run; take the next step when the previous one has ended.

        Steps whose condition is false are left out. A repetition without any step is the last one.
        Steps and repetitions count from 1; a later repetition begins with the first step.

        Raises:
            BadValueError: There is no such step.
        """
        begin, repetition = self._index_of(first), repetition - 1
        self._stop_count = self._arm.background.stop_count
        while (repetition := repetition + 1) <= self._program.repetitions:
            steps = list(enumerate(self._program.steps, 1))[begin:]
            begin, has_run = 0, False
            for number, step in steps:
                for each in self._steps_of(step, number, repetition):
                    yield each
                    has_run = True
            if not has_run:
                return

    def _steps_of(self, step: ProgramStep, number: int, repetition: int) -> Iterator[NextStep]:
        """Yield a step, or the steps of the program that it calls, if its condition is true."""
        if not self._applies(step):
            return
        if step.program is None:
            at, speed = step.at_repetition(repetition), self._program.speed_of(step)
            yield NextStep(number, repetition, at, speed, self._folder)
            return
        called, folder = self._called[step.program], (self._folder / step.program).parent
        for inner in range(1, int(called.repetitions) + 1):
            for each in called.steps:
                if self._applies(each):
                    at, speed = each.at_repetition(inner), called.speed_of(each)
                    yield NextStep(number, repetition, at, speed, folder)

    def _applies(self, step: ProgramStep) -> bool:
        return step.only_if is None or (step.only_if == "grasped") == self.has_grasped

    def run_step(self, step: NextStep, on_progress: OnProgress | None = None) -> StepReport | None:
        """Run a step; return the report of its motion, or None for a wait or a pause.

        The caller waits for the person during a pause.

        Raises:
            IkservoError: The step failed; the arm holds where it is. See ``Arm``.
        """
        if step.step.pause is not None:
            return None
        with self._arm.background.requested(self._stop_count):
            motion = self._motion(step)
            if isinstance(motion, Wait):
                self.wait(motion)
                return None
            self._has_moved = True
            with self._arm.background.turn():
                report = run_motion(self._arm, motion, on_progress)
        if isinstance(report, GraspResult):
            self.has_grasped = report.grasped
        return report

    def wait(self, motion: Wait) -> None:
        """Wait, and watch the servos that hold."""
        wait(self._arm.context, motion, self._on_wait, watch_health=self._has_moved)

    def _index_of(self, number: int) -> int:
        count = len(self._program.steps)
        if not 1 <= number <= count:
            raise BadValueError("The step", number, f"a step from 1 to {count}")
        return number - 1

    def _motion(self, step: NextStep) -> MotionValue[Any]:
        """Return the motion of a step; recordings are read from the program's folder.

        Raises:
            BadValueError: This arm cannot perform the step.
            UnknownNameError: There is no such joint.
        """
        motion = step.step.to_motion(self._arm.context.model, step.speed)
        if isinstance(motion, Replay):
            return replace(motion, path=step.folder / motion.path)
        return motion
