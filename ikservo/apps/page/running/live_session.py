"""Goals of the arm while Live is on, and detection of a silent page."""

from __future__ import annotations

from typing import Protocol

from ikservo.apps.page.dragging.snapshot import ArmCommand
from ikservo.control.loop import ControlCycle
from ikservo.errors import RefusedError
from ikservo.kinematics.arrays import Vector
from ikservo.serving.lease import ArmLease


class CycleObserver(Protocol):
    """Receiver of every control cycle, and source of the current command."""

    @property
    def command(self) -> ArmCommand:
        """The current command."""
        ...

    def on_cycle(self, cycle: ControlCycle) -> None:
        """Receive a control cycle."""
        ...

    def on_refused(self, goal: Vector, error: RefusedError, kept: Vector) -> None:
        """Receive a goal (n,) that the guard refused, and the goal (n,) that the arm keeps."""
        ...


class LiveSession:
    """Source of the arm's goal while Live is on (``ikservo.arm.following.GoalSource``).

    Attributes:
        session_id: Identifies the session.
        silent: Whether the session ended because no heartbeat arrived.
    """

    def __init__(self, observer: CycleObserver, lease: ArmLease) -> None:
        self._observer, self._lease = observer, lease
        self.session_id, self.speed = observer.command.session_id, observer.command.speed
        self._start: Vector | None = None
        self._last_goal: Vector | None = None
        self._had_goal = self.silent = False

    def next_goal(self, cycle: ControlCycle) -> Vector | None:
        """Compute the goal of all joints (n,); None once the session has ended."""
        self._observer.on_cycle(cycle)
        command = self._observer.command
        if self._start is None:
            self._start = cycle.reference.copy()
        self.silent = self._lease.is_silent
        if self.silent or self.is_over or command.speed != self.speed:
            return None
        self._had_goal = self._had_goal or command.goal is not None
        if self._had_goal and command.goal is None:
            return None  # the goal was withdrawn: the arm brakes and holds
        self._last_goal = self._start if command.goal is None else command.goal
        return self._last_goal

    @property
    def is_over(self) -> bool:
        """Whether Live was switched off since the start, even if it is on again."""
        command = self._observer.command
        return not command.live or command.session_id != self.session_id

    def on_rejected(self, error: RefusedError, kept: Vector) -> None:
        """Report why the guard rejected a goal; the arm keeps the previous goal."""
        if self._last_goal is not None:
            self._observer.on_refused(self._last_goal, error, kept)
