"""Jobs of the arm thread: what the arm does by itself until it is done or stopped."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from typing import Protocol

from ikservo.apps.cameras.tip_click import TipZero, save_tip_zero
from ikservo.apps.page.dragging.goal_planning import PlannedPath, PlanRequest, plan_path
from ikservo.arm import Arm, MotionProgress
from ikservo.errors import RefusedError
from ikservo.kinematics.arrays import Vector


class JobObserver(Protocol):
    """Shows what the arm does meanwhile, and stops it where the page falls silent."""

    def on_progress(self, progress: MotionProgress) -> None:
        """Receive the state of a motion in each control cycle."""
        ...

    def on_idle(self) -> None:
        """Read the arm at rest; to be called now and then while a job does not move it.

        Raises:
            RefusedError: The arm was stopped.
        """
        ...

    def on_guided(self, measured: Vector) -> None:
        """Receive joints (n,) of an arm that is guided by hand; it moves nothing by itself.

        Raises:
            RefusedError: The arm was stopped.
        """
        ...

    def on_torque_off(self) -> None:
        """Read the arm after its torque was switched off, which is not a loss of torque then."""
        ...

    def reopen(self) -> None:
        """Open the arm again, after it was calibrated."""
        ...

    def log_message(self, message: str, level: str = "bad") -> None:
        """Append a message for the user; its level is empty if nothing went wrong."""
        ...


class ArmJob(Protocol):
    """Runs in the arm thread.

    Attributes:
        title: The activity of the arm, in a few words.
        is_planned: Whether all that moves was planned and checked before it begins. Only such a
            job goes on through a hiccup of the page; one that follows live goals does not.
    """

    @property
    def title(self) -> str:
        """What the arm does, in a few words."""
        ...

    @property
    def is_planned(self) -> bool:
        """Whether all that moves was planned and checked before it begins."""
        ...

    def run(self, arm: Arm, observer: JobObserver) -> None:
        """Run to the end.

        Raises:
            IkservoError: It failed; the arm holds until that is acknowledged.
        """
        ...


class ExecutePath:
    """Carries out the path that the page shows, as it was planned."""

    title = "Goes to the preview"
    is_planned = True

    def __init__(self, path: PlannedPath) -> None:
        self._path = path

    def run(self, arm: Arm, observer: JobObserver) -> None:
        """Execute the plan; an obsolete one moves nothing and needs no stop."""
        before, servos = self._path.request, arm.context.servos
        with ExitStack() as turns:
            try:
                turns.enter_context(arm.runner.undisturbed())
            except RefusedError as error:  # by another arm
                observer.log_message(f"{error.message} {error.command_hint}")
                return
            if servos.torque.is_on:
                servos.refresh_reference()
            else:
                arm.enable()  # it may sink until then
            now = PlanRequest(
                arm, before.goal, servos.reference(), before.speed, marker=before.marker
            )
            has_sagged = now.has_sagged_since(before)
            path = plan_path(arm, now) if has_sagged else self._path
            try:
                plan = path.plan_for(now)
            except RefusedError as error:
                observer.log_message(f"{error.message} {error.command_hint}")
                return
            arm.execute(replace(plan, limp_arm=None), observer.on_progress)


class RelaxArm:
    """Lowers the arm to its rest pose and switches torque off."""

    title = "Lowers itself to rest, then goes limp"
    is_planned = True

    def run(self, arm: Arm, observer: JobObserver) -> None:
        """Lower the arm, then switch torque off."""
        result = arm.relax(observer.on_progress)
        observer.on_torque_off()
        how = "lowered to its rest pose" if result.reached else "not lowered to its rest pose"
        level = "" if result.reached else "bad"
        observer.log_message(f"The arm was {how}; torque is off.", level)


class ReleaseArm:
    """Switches every servo's torque off where the arm is."""

    title = "Goes limp"
    is_planned = True

    def run(self, arm: Arm, observer: JobObserver) -> None:
        """Switch torque off; an arm that is not supported falls."""
        arm.disable_torque()
        observer.on_torque_off()
        observer.log_message("Torque of all servos switched off from the page.", "")


class SetTipZero:
    """Saves the zero that a click on the tip has shown, and opens the arm with it.

    Args:
        found: The zero.
    """

    title = "Is opened with its new zero"
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
