"""Job that plays a program: checks all steps first, then runs them together or one by one."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from ikservo.apps.page.running.arm_job import JobObserver
from ikservo.apps.teaching.program import Program
from ikservo.apps.teaching.program_run import ProgramRun
from ikservo.arm import Arm
from ikservo.errors import BusError, IkservoError
from ikservo.maintenance.dialogue import Progress
from ikservo.planning.motions import Wait

Phase = Literal["idle", "checking", "ok", "playing", "waiting", "paused", "stopped", "bad", "done"]
_POLL_S = 0.1  # interval at which a pause asks whether it has ended


@dataclass(frozen=True, slots=True)
class PlayState:
    """Progress of a program.

    Attributes:
        phase: The present phase; ``bad`` after a check that found an impossible step; ``waiting``
            in a step that pauses until a person continues.
        step: Number of the present or next step; None before the start.
        repetition: The repetition of the whole program, from 1.
        reason: The reason why the program was stopped at this step, or the text of a pause.
        problems: Reasons why steps are impossible, by number; ``step`` is the first such step.
    """

    phase: Phase = "idle"
    step: int | None = None
    repetition: int = 1
    reason: str = ""
    problems: Mapping[int, str] = field(default_factory=dict[int, str])


class ProgramPlay:
    """Job that checks and plays a program (``ArmJob``). Nothing moves until the check has passed.

    Args:
        program: The program.
        numbers: Numbers by which the page names its steps.
        folder: The folder of its recordings.
        first: Index of the step to begin with.
        action: ``check`` only, ``play`` to the end, or run one ``step``.

    Attributes:
        state: The progress; written by the arm thread alone.
    """

    is_planned = True

    def __init__(
        self,
        program: Program,
        numbers: tuple[int, ...],
        folder: Path,
        first: int,
        action: Literal["check", "play", "step"],
    ) -> None:
        self._program, self._numbers, self._folder = program, numbers, folder
        self._first, self._index, self._action = first, first, action
        self._pausing, self._continuing = threading.Event(), threading.Event()
        self._repetition, self._has_grasped = 1, False
        self._seconds = [math.nan] * len(
            numbers
        )  # duration of each step: planned, or else as first measured
        self._done_s = self._began_s = self._step_began_s = 0.0
        self.state = PlayState("checking", numbers[first])

    @property
    def title(self) -> str:
        """Activity of the arm, in a few words."""
        if self._action == "check":
            return "Checking the program"
        step = f", step {self._index + 1} of {len(self._numbers)}"
        return f"Playing the program{step if self.state.phase == 'playing' else ''}"

    def left(self, now_s: float) -> str:
        """Return the time left of the whole program, in words; empty if that is not known."""
        later = self._program.repetitions - self._repetition
        total_s = sum(self._seconds[self._first :]) + (later and later * sum(self._seconds))
        done_s = self._done_s + min(now_s - self._step_began_s, self._seconds[self._index])
        is_known = self.state.phase == "playing" and math.isfinite(total_s + done_s)
        if not is_known or self._action == "step":
            return ""
        return Progress("", done_s, total_s, now_s - self._began_s).left

    @property
    def is_pausing(self) -> bool:
        """Whether the program will pause after the present step."""
        return self._pausing.is_set()

    def pause(self) -> None:
        """Pause after the present step; safe from any thread."""
        self._pausing.set()

    def resume(self) -> None:
        """Continue after a step that pauses; safe from any thread."""
        self._continuing.set()

    def continue_from(self, before: ProgramPlay, number: int | None) -> None:
        """Begin in the repetition in which a previous play paused or stopped at the step."""
        self._has_grasped = before._has_grasped
        if before._numbers == self._numbers:
            self._seconds = list(before._seconds)
        if number is not None and number == before.state.step and before.state.phase != "bad":
            self._repetition = before.state.repetition

    def run(self, arm: Arm, observer: JobObserver) -> None:
        """Check the steps, then run them.

        Raises:
            IkservoError: A step failed, or the arm was stopped during it; the arm holds.
        """
        try:
            run = ProgramRun(
                arm,
                self._program,
                self._folder,
                arm.poses,
                observer.on_idle,
                has_grasped=self._has_grasped,
            )
        except IkservoError as error:  # from a program that it calls
            observer.log_message(error.message)
            number = self._numbers[self._first]
            self.state = PlayState("bad", number, problems={number: error.message})
            return
        try:
            if self._check(run, observer) and self._action != "check":
                self._play(run, observer, arm.context.now_s)
        except IkservoError as error:
            self.state = replace(self.state, phase="stopped", reason=error.message)
            raise

    def _check(self, run: ProgramRun, observer: JobObserver) -> bool:
        """Check whether every step is possible; the state names all impossible steps."""
        problems: dict[int, str] = {}  # by index, because repetitions check again
        try:
            for check in run.check(self._first + 1):
                if self._action == "step" and check.number - 1 != self._first:
                    break
                observer.on_idle()
                self._note_step(check.number - 1, "checking")
                step = self._program.steps[check.number - 1]
                if not (step.program or step.only_if or math.isnan(check.duration_s)):
                    self._seconds[check.number - 1] = check.duration_s
                if check.error is not None:
                    problems.setdefault(check.number - 1, check.error.message)
        except BusError:
            raise
        except IkservoError as error:  # the present state of the arm prevents planning
            observer.on_idle()
            problems = {self._first: error.message}
        if problems:
            for index, reason in problems.items():
                observer.log_message(f"Step {index + 1} of the program is impossible: {reason}")
            by_number = {self._numbers[index]: reason for index, reason in problems.items()}
            self.state = PlayState("bad", next(iter(by_number)), problems=by_number)
            return False
        self._note_step(self._first, "ok")
        return True

    def _play(self, run: ProgramRun, observer: JobObserver, now_s: Callable[[], float]) -> None:
        self._began_s = now_s()
        for made, each in enumerate(run.steps(self._first + 1, self._repetition)):
            is_next = each.number - 1 != self._first or each.repetition != self._repetition
            if (is_next and self._action == "step") or (made and self._pausing.is_set()):
                self._note_step(each.number - 1, "paused", each.repetition)
                return
            if each.step.pause is None:
                self._step_began_s = now_s()
                self._note_step(each.number - 1, "playing", each.repetition)
                run.run_step(each, observer.on_progress)
                self._has_grasped = run.has_grasped
                self._note_duration(each.number - 1, now_s() - self._step_began_s)
            else:
                self._continuing.clear()
                number = self._numbers[each.number - 1]
                self.state = PlayState("waiting", number, each.repetition, each.step.pause)
                while not (self._continuing.is_set() or self._pausing.is_set()):
                    run.wait(Wait(_POLL_S))
        self._note_step(0, "done")

    def _note_duration(self, index: int, measured_s: float) -> None:
        step = self._program.steps[index]
        if math.isnan(self._seconds[index]) and not (step.program or step.only_if):
            self._seconds[index] = measured_s
        self._done_s += self._seconds[index]

    def _note_step(self, index: int, phase: Phase, repetition: int = 1) -> None:
        self._index = index
        self.state = PlayState(phase, self._numbers[index], repetition)
