"""Sends the setpoints of the newest goal to an arm, through its guard, until it has arrived."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from enum import Enum, auto
from typing import Protocol

import numpy as np

from ikservo.arm import Arm, SetpointStream
from ikservo.errors import IkservoError, RefusedError
from ikservo.kinematics.arrays import Vector
from ikservo.network.ros.goals import MotionGoal

__all__ = ["GoalDriver", "GoalEnd", "GoalWatch"]

_PERIOD_S = 0.02
_STILL_RAD, _STILL_S = 0.002, 0.3  # no joint moved further in this time: it has arrived
_START_S = 2.0  # until when the arm moves at the latest, its torque being switched on before
_MAX_ARRIVAL_S = 30.0


class GoalEnd(Enum):
    """How a goal has ended."""

    ARRIVED = auto()
    """The arm is where it led to, as far as the guard allows, and at rest."""
    ENDED = auto()
    """It was taken back; the arm was braked and holds."""
    REPLACED = auto()
    """A newer goal was put in its place."""
    FAILED = auto()
    """The arm was stopped, or the guard or a servo has ended the motion."""


class GoalWatch(Protocol):
    """Watches a goal that is being followed; called in the driver's thread, or by ``put``."""

    def observe(self, now_s: float, positions: Mapping[str, float], /) -> bool:
        """Take measured positions; return whether to go on."""
        ...

    def ended(self, end: GoalEnd, why: str, /) -> None:
        """Take note that the goal has ended, and why early."""
        ...


@dataclass(slots=True, eq=False)
class _Task:
    goal: MotionGoal
    watch: GoalWatch | None
    stop_count: int
    reported: bool = False

    def observe(self, now_s: float, positions: Mapping[str, float]) -> bool:
        return self.watch is None or self.watch.observe(now_s, positions)

    def ended(self, end: GoalEnd, why: str = "") -> None:
        """Report the end, once."""
        if self.watch is not None and not self.reported:
            self.reported = True
            self.watch.ended(end, why)


class GoalDriver:
    """Drives an arm in a thread of its own, until it is closed.

    Args:
        arm: The arm.
        speed: The speed class.
        warn: Called with the reason where a goal is refused or has ended early.
    """

    def __init__(self, arm: Arm, speed: str, warn: Callable[[str], None]) -> None:
        self._arm, self._speed, self._warn = arm, speed, warn
        self._changed = threading.Condition()
        self._task: _Task | None = None  # the newest
        self._running: _Task | None = None  # the last that was followed
        self._busy = self._closing = False
        self._thread = threading.Thread(target=self._run, name="ikservo-ros-goals", daemon=True)
        self._thread.start()

    @property
    def goal(self) -> MotionGoal | None:
        """Return the goal that is being followed."""
        task = self._task
        return None if task is None else task.goal

    @property
    def is_moving(self) -> bool:
        """Return whether the arm moves, or brakes."""
        return self._busy

    def put(self, goal: MotionGoal | None, watch: GoalWatch | None = None) -> None:
        """Replace the goal; None brakes and holds."""
        stop_count = self._arm.background.stop_count
        self._replace(None if goal is None else _Task(goal, watch, stop_count))

    def cancel(self, watch: GoalWatch) -> None:
        """Brake and hold, where the goal with this watch is the newest."""
        with self._changed:
            if self._task is not None and self._task.watch is watch:
                self._replace(None)

    def wait_until_still(self, timeout_s: float) -> None:
        """Wait until the arm has come to rest.

        Raises:
            RefusedError: It did not in time.
        """
        with self._changed:
            if not self._changed.wait_for(lambda: not self._busy, timeout_s):
                raise RefusedError("The arm is still braking.", "Try again.")

    def close(self) -> None:
        """Brake, hold and end the thread."""
        with self._changed:
            self._closing = True
            self._replace(None)
        self._thread.join(10.0)

    def _replace(self, task: _Task | None, end: GoalEnd = GoalEnd.ENDED, why: str = "") -> None:
        """Replace the newest goal; one that is being followed ends once the arm is at rest."""
        with self._changed:
            before, self._task = self._task, task
            followed = before is self._running and self._busy
            self._changed.notify_all()
        if before is not None and task is not None:
            before.ended(GoalEnd.REPLACED)
        elif before is not None and not followed:
            before.ended(end, why)

    def _run(self) -> None:
        while self._await_goal():
            end, why = GoalEnd.FAILED, ""
            try:
                with self._requested(), self._arm.stream(speed=self._speed) as stream:
                    end = self._follow(stream)
                why = _reason_of(stream)
            except Exception as error:  # this thread must not end: nobody would drive the arm
                end, why = GoalEnd.FAILED, _text_of(error)
                self._replace(None, end, why)
            if why:
                self._warn(why)
            self._rest(end, why)

    def _requested(self) -> AbstractContextManager[None]:
        """Mark a motion as requested when its goal was put, which may be before a stop."""
        return self._arm.background.requested(self._running and self._running.stop_count)

    def _rest(self, end: GoalEnd, why: str) -> None:
        """Report the goal that was followed last; the arm is at rest."""
        try:
            if self._running is not None:
                self._running.ended(end, why)
        except Exception as error:  # likewise
            self._warn(_text_of(error))
        finally:
            with self._changed:
                self._busy, self._running = False, None
                self._changed.notify_all()

    def _await_goal(self) -> bool:
        """Wait for a goal; return False once closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._closing or self._task is not None)
            self._running, self._busy = self._task, self._task is not None
            return not self._closing

    def _follow(self, stream: SetpointStream) -> GoalEnd:
        """Send setpoints until the newest goal has ended and the arm is still, or none is left."""
        still, end = _Stillness(), GoalEnd.ENDED
        due_s = began_s = time.monotonic()
        while True:
            before, task = self._take()
            if task is None:
                return end
            if before is not None and before is not task:  # one that has ended, or was replaced
                before.ended(end)
                end = GoalEnd.ENDED
            goal, now_s, state = task.goal, time.monotonic(), self._arm.where()
            if not _is_running(stream, now_s - began_s):
                goal.delay(now_s)
            if not task.observe(now_s, state.positions):
                self._finish(task)
                continue
            ended = goal.has_ended(now_s)
            stream.send(goal.setpoint(now_s, state.tip_m))
            if not ended:
                still = _Stillness()
            elif not goal.arrives or still.reached(now_s, state.positions_rad):
                end = self._finish(task)
            due_s = max(due_s + _PERIOD_S, now_s)
            time.sleep(max(0.0, due_s - time.monotonic()))

    def _take(self) -> tuple[_Task | None, _Task | None]:
        """Return the goal that was followed, and the newest, which is followed from now on."""
        with self._changed:
            before = self._running
            self._running = self._task or self._running
            return before, self._task

    def _finish(self, task: _Task) -> GoalEnd:
        """End a goal that has arrived; return what becomes of it."""
        with self._changed:
            if self._task is not task:  # a newer one came meanwhile
                return GoalEnd.ENDED
            self._task = None
            return GoalEnd.ARRIVED


def _reason_of(stream: SetpointStream) -> str:
    if stream.reason:
        return stream.reason
    if stream.unreached:
        return "The goal is out of reach; the arm went as near as it could."
    return ""


def _text_of(error: Exception) -> str:
    if isinstance(error, IkservoError):
        return error.message
    return f"The motion has failed: {type(error).__name__}: {error}"


def _is_running(stream: SetpointStream, elapsed_s: float) -> bool:
    """Return whether the control loop follows: before, servos are read and torque comes on."""
    if elapsed_s > _START_S:
        return True
    progress: object = getattr(stream, "progress", stream)  # of an arm elsewhere it is not known
    return progress is not None


class _Stillness:
    """Notices that joints have stopped moving."""

    def __init__(self) -> None:
        self._began_s: float | None = None
        self._since_s, self._at, self._moved = 0.0, np.zeros(0), False

    def reached(self, now_s: float, positions: Vector) -> bool:
        """Return whether no joint has moved for a while, or it takes too long."""
        self._began_s = now_s if self._began_s is None else self._began_s
        first = len(self._at) == 0
        if first or np.abs(positions - self._at).max() > _STILL_RAD:
            self._since_s, self._at, self._moved = now_s, positions, not first
        elapsed_s = now_s - self._began_s
        started = self._moved or elapsed_s > _START_S
        return (started and now_s - self._since_s > _STILL_S) or elapsed_s > _MAX_ARRIVAL_S
