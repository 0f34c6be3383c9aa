"""Check and run programs: each step is planned from the end of the previous step."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ikservo.apps.teaching.program import Program, ProgramStep
from ikservo.apps.teaching.replaying import Replay, position_at_rest
from ikservo.arm.arm_parts import ArmParts
from ikservo.arm.run_by_kind import end_of_motion, run_motion, wait
from ikservo.errors import BadValueError, IkservoError
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

StepReport = MoveResult | JointMoveResult | GraspResult | ReplayResult
"""Report on the motion of a step."""


@dataclass(frozen=True, slots=True)
class StepCheck:
    """Result of checking a step.

    Attributes:
        number: The number of the step, from 1.
        step: The step.
        error: The reason why the step is impossible; None if it is possible.
    """

    number: int
    step: ProgramStep
    error: IkservoError | None


@dataclass(frozen=True, slots=True)
class StepResult:
    """Result of a step that was run.

    Attributes:
        number: The number of the step, from 1.
        repetition: The repetition of the program, from 1.
        step: The step.
        report: The report on the motion; None for a wait.
    """

    number: int
    repetition: int
    step: ProgramStep
    report: StepReport | None


class ProgramRun:
    """A program on an arm, which can be checked, then run as a whole, from a step, or stepwise.

    Args:
        arm: The arm.
        program: The program.
        folder: The folder that contains the program and its recordings.
        poses: The poses of the arm.
        on_wait: Called regularly during a wait.

    Raises:
        BadValueError: The program is for another arm.
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
        self._has_moved = False  # torque may be off before the first motion

    def check(self, first: int = 1) -> Iterator[StepCheck]:
        """Plan each step from the end of the previous step; nothing moves.

        The first step starts at the present position. With ``repeat``, the first step is also
        checked from the end of the last one. After an impossible step the check continues as if the
        program did not have that step.

        Args:
            first: The step to begin with, from 1.

        Raises:
            BadValueError: There is no such step.
            CalibrationError: The arm is not calibrated.
        """
        begin = self._index_of(first)
        self._arm.context.require_zeros()
        start = PlannedStart(position_at_rest(self._arm))
        numbers = list(range(begin, len(self._program.steps)))
        if self._program.repeat > 1:
            numbers += range(begin + 1)
        for index in numbers:
            step = self._program.steps[index]
            error: IkservoError | None = None
            context = self._arm.context
            preflight = PreflightPlanner(context, start, self._poses)
            try:
                motion = self._motion(step)
                start.joints = end_of_motion(context, preflight, motion, start.joints)
            except IkservoError as refused:
                error = refused
            yield StepCheck(index + 1, step, error)

    def run(self, first: int = 1, on_progress: OnProgress | None = None) -> Iterator[StepResult]:
        """Run the steps; each result that the caller takes from the iterator runs one step.

        Args:
            first: The step to begin with, from 1; repetitions begin with the first step.
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
                    motion, report = self._motion(step), None
                    if isinstance(motion, Wait):
                        wait(self._arm.context, motion, self._on_wait, watch_health=self._has_moved)
                    else:
                        self._has_moved = True
                        with self._arm.background.turn():
                            report = run_motion(self._arm, motion, on_progress)
                yield StepResult(index + 1, repetition, step, report)
            begin = 0

    def _index_of(self, number: int) -> int:
        count = len(self._program.steps)
        if not 1 <= number <= count:
            raise BadValueError("The step", number, f"1 to {count}")
        return number - 1

    def _motion(self, step: ProgramStep) -> MotionValue[Any]:
        """Return the motion of a step; recordings are read from the program's folder.

        Raises:
            BadValueError: This arm cannot perform the step.
            UnknownNameError: There is no such joint.
        """
        motion = step.to_motion(self._arm.context.model, self._program.speed_of(step))
        if isinstance(motion, Replay):
            return replace(motion, path=self._folder / motion.path)
        return motion
