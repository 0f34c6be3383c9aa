"""Jobs of the arm thread, which run until they are done or stopped."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Protocol

from ikservo.apps.cameras.tip_click import TipZero, save_tip_zero
from ikservo.apps.page.dragging.goal_planning import PlannedPath, PlanRequest, plan_path
from ikservo.arm import Arm, MotionProgress
from ikservo.errors import InputError, RefusedError, UnreachableError
from ikservo.kinematics.arrays import Vector


class JobObserver(Protocol):
    """Observer that shows the arm during a job, and stops the arm if the page falls silent."""

    def on_progress(self, progress: MotionProgress) -> None:
        """Receive the state of a motion in each control cycle."""
        ...

    def on_idle(self) -> None:
        """Read the arm at rest; called regularly while a job does not move it.

        Raises:
            RefusedError: The arm was stopped.
        """
        ...

    def on_guided(self, measured: Vector) -> None:
        """Receive joints (n,) of an arm that is guided by hand and does not move itself.

        Raises:
            RefusedError: The arm was stopped.
        """
        ...

    def on_torque_off(self) -> None:
        """Read the arm after its torque was switched off on purpose."""
        ...

    def reopen(self) -> None:
        """Open the arm again after a calibration."""
        ...

    def log_message(self, message: str, level: str = "bad") -> None:
        """Append a message for the user; the level is empty if nothing went wrong."""
        ...


class ArmJob(Protocol):
    """A job that runs in the arm thread.

    Attributes:
        title: The activity of the arm, in a few words.
        is_planned: Whether all motions are planned and checked before the job begins. Only such a
            job continues during a short silence of the page.
    """

    @property
    def title(self) -> str:
        """Activity of the arm, in a few words."""
        ...

    @property
    def is_planned(self) -> bool:
        """Whether all motions are planned and checked before the job begins."""
        ...

    def run(self, arm: Arm, observer: JobObserver) -> None:
        """Run the job to its end.

        Raises:
            IkservoError: The job failed; the arm holds until a user acknowledges the failure.
        """
        ...


@contextmanager
def refusals_logged(arm: Arm, observer: JobObserver) -> Generator[None]:
    """Log a refusal in the ``with`` block, unless the refusal has stopped the arm."""
    try:
        yield
    except (InputError, RefusedError, UnreachableError) as error:
        if arm.stop_reason is not None:
            raise
        observer.log_message(f"{error.message} {error.command_hint}")


class ExecutePath:
    """Job that executes the planned path that the page shows."""

    title = "Moving to the target of the preview"
    is_planned = True

    def __init__(self, path: PlannedPath) -> None:
        self._path = path

    def run(self, arm: Arm, observer: JobObserver) -> None:
        """Execute the plan; an obsolete plan moves nothing and does not stop the arm."""
        before, servos = self._path.request, arm.context.servos
        with ExitStack() as turns:
            turns.enter_context(refusals_logged(arm, observer))
            turns.enter_context(arm.runner.undisturbed())
            if servos.torque.is_on:
                servos.refresh_reference()
            else:
                arm.enable()  # a limp arm may sink until then
            now = PlanRequest(
                arm, before.goal, servos.reference(), before.speed, marker=before.marker
            )
            run = self._path.run
            has_sagged = run is None and now.has_sagged_since(before)
            if has_sagged:
                now.goal = before.goal_from(now.start)
            plan = (plan_path(arm, now) if has_sagged else self._path).plan_for(now)
            if run is None:
                arm.execute(replace(plan, limp_arm=None), observer.on_progress)
            else:
                run(arm, observer.on_progress)
            servos.refresh_reference()  # the next plan begins where the joints rest


class RelaxArm:
    """Job that lowers the arm to its rest pose and switches torque off."""

    title = "Lowering to rest, then going limp"
    is_planned = True

    def run(self, arm: Arm, observer: JobObserver) -> None:
        """Lower the arm, then switch torque off."""
        result = arm.relax(observer.on_progress)
        observer.on_torque_off()
        how = "lowered to its rest pose" if result.reached else "not lowered to its rest pose"
        level = "" if result.reached else "bad"
        observer.log_message(f"The arm was {how}; torque is off.", level)


class ReleaseArm:
    """Job that switches torque off at the present position of the arm."""

    title = "Going limp"
    is_planned = True

    def run(self, arm: Arm, observer: JobObserver) -> None:
        """Switch torque off; an arm that is not supported falls."""
        arm.disable_torque()
        observer.on_torque_off()
        observer.log_message("Torque of all servos switched off from the page.", "")


class SetTipZero:
    """Job that saves the zero from a click on the tip, and reopens the arm with that zero."""

    title = "Reopening the arm with the new zero"
    is_planned = True

    def __init__(self, found: TipZero) -> None:
        self._found = found

    def run(self, arm: Arm, observer: JobObserver) -> None:
        """Save the calibration; the arm keeps its torque and does not move."""
        save_tip_zero(arm, self._found)
        observer.reopen()
        observer.log_message(
            f"{self._found} Saved. To undo the click: ikservo calibration undo {arm.model.name}. "
            f"{self._found.advice}".rstrip(),
            "",
        )
