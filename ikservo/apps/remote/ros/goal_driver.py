"""Driver that sends the setpoints of the newest goal to an arm until it has arrived."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum, auto
from typing import Protocol

from ikservo.apps.remote.ros.goals import MotionGoal
from ikservo.arm import OpenArm
from ikservo.arm.arm_protocol import GoalStream
from ikservo.control.stillness import StillnessDetector
from ikservo.errors import IkservoError, RefusedError
from ikservo.kinematics.arrays import Vector

_PERIOD_S = 0.02
# A joint has arrived if it moves less in this time; encoder noise at rest is two ticks.
_STILL_RAD, _STILL_S = 0.0035, 0.3
_START_S = 2.0  # longest time until the arm moves, including torque-on
_MAX_ARRIVAL_S = 30.0


class GoalEnd(Enum):
    """The way in which a goal ended."""

    ARRIVED = auto()
    """The arm rests at the goal, or as close to it as the guard allows."""
    ENDED = auto()
    """The goal was cancelled; the arm has braked and holds."""
    REPLACED = auto()
    """A newer goal has replaced this goal."""
    FAILED = auto()
    """The arm was stopped, or the guard or a servo has ended the motion."""


class GoalWatch(Protocol):
    """Watcher of a goal that is being followed; called in the driver's thread, or by ``put``."""

    def observe(self, now_s: float, positions: Mapping[str, float], /) -> bool:
        """Receive measured positions; return whether to go on."""
        ...

    def ended(self, end: GoalEnd, why: str, /) -> None:
        """Record that the goal has ended, and the reason if it ended early."""
        ...


@dataclass(slots=True, eq=False)
class _Task:
    goal: MotionGoal
    watch: GoalWatch | None
    stop_count: int
    end: GoalEnd = GoalEnd.ENDED

    def observe(self, now_s: float, positions: Mapping[str, float]) -> bool:
        return self.watch is None or self.watch.observe(now_s, positions)


class GoalDriver:
    """Driver of an arm in a separate thread until it is closed; warns if a goal ends early.

    Attributes:
        is_moving: Whether the arm is moving or braking.
    """

    def __init__(self, arm: OpenArm, speed: str, warn: Callable[[str], None]) -> None:
        self._arm, self._speed, self._warn = arm, speed, warn
        self._changed = threading.Condition()
        self._task: _Task | None = None  # newest goal
        self._ending: list[_Task] = []  # reported once the arm is at rest
        self.is_moving = self._closing = False
        self._thread = threading.Thread(target=self._run, name="ikservo-ros-goals", daemon=True)
        self._thread.start()

    @property
    def goal(self) -> MotionGoal | None:
        """The goal that is being followed."""
        task = self._task
        return None if task is None else task.goal

    def put(self, goal: MotionGoal | None, watch: GoalWatch | None = None) -> None:
        """Replace the goal; None brakes and holds."""
        background = self._arm.background
        self._replace(None if goal is None else _Task(goal, watch, background.stop_count))

    def cancel(self, watch: GoalWatch) -> None:
        """Brake and hold, if the goal with this watch is the newest."""
        with self._changed:
            if self._task is not None and self._task.watch is watch:
                self._replace(None)

    def wait_until_still(self, timeout_s: float) -> None:
        """Wait until the arm has come to rest.

        Raises:
            RefusedError: The arm has not come to rest in time.
        """
        with self._changed:
            if not self._changed.wait_for(lambda: not self.is_moving, timeout_s):
                raise RefusedError("The arm is still braking.", "Try again.")

    def close(self) -> None:
        """Brake, hold and end the thread."""
        with self._changed:
            self._closing = True
            self._replace(None)
        self._thread.join(10.0)

    def _replace(self, task: _Task | None) -> None:
        """Replace the newest goal; without a new goal, the old one ends when the arm rests."""
        with self._changed:
            before, self._task = self._task, task
            self._changed.notify_all()
            if before is None:
                return
            if task is None and self.is_moving:
                self._ending.append(before)
                return
        self._report(before, GoalEnd.ENDED if task is None else GoalEnd.REPLACED)

    def _run(self) -> None:
        while (task := self._await_goal()) is not None:
            failed, why = False, ""
            try:
                # The motion was requested by put(), perhaps before a stop.
                requested = self._arm.background.requested(task.stop_count)
                with requested, self._arm.stream(speed=self._speed) as stream:
                    self._follow(stream)
                why = stream.reason
                if not why and stream.unreached:
                    why = "The goal is out of reach; the arm moved as close to it as it could."
            except Exception as error:  # this thread must go on, because it drives the arm
                failed, why = True, _text_of(error)
                self._replace(None)
            if why:
                self._warn(why)
            with self._changed:  # the arm is at rest
                ending, self._ending, self.is_moving = self._ending, [], False
                self._changed.notify_all()
            for ended in ending:
                self._report(ended, GoalEnd.FAILED if failed else ended.end, why)

    def _report(self, task: _Task, end: GoalEnd, why: str = "") -> None:
        try:
            if task.watch is not None:
                task.watch.ended(end, why)
        except Exception as error:  # a failing callback must not end the driver
            self._warn(_text_of(error))

    def _await_goal(self) -> _Task | None:
        """Wait for a goal; return None once closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._closing or self._task is not None)
            if self._closing:
                return None
            self.is_moving = True
            return self._task

    def _follow(self, stream: GoalStream) -> None:
        """Send setpoints until the newest goal has ended and the arm rests, or there is no goal."""
        followed, arrival = None, _Arrival()
        due_s = began_s = time.monotonic()
        while (task := self._take()) is not None:
            goal, now_s, state = task.goal, time.monotonic(), self._arm.where()
            # There is no progress before the control loop runs, while torque is switched on, and
            # never from an arm on another machine.
            progress: object = getattr(stream, "progress", stream)
            if progress is None and now_s - began_s <= _START_S:
                goal.delay(now_s)
            if not task.observe(now_s, state.positions):
                self._finish(task, GoalEnd.ENDED)
                continue
            ended = goal.has_ended(now_s)
            stream.send(goal.setpoint(now_s, state.tip_m))
            if not ended or task is not followed:
                arrival = _Arrival()
            elif not goal.arrives or arrival.reached(now_s, state.positions_rad):
                self._finish(task, GoalEnd.ARRIVED)
            followed = task
            due_s = max(due_s + _PERIOD_S, now_s)
            time.sleep(max(0.0, due_s - time.monotonic()))

    def _take(self) -> _Task | None:
        """Take the newest goal, if any, and report the earlier goals that it interrupts."""
        with self._changed:
            task, before = self._task, []
            if task is not None:
                before, self._ending = self._ending, []
        for each in before:
            self._report(each, GoalEnd.REPLACED if each.end is GoalEnd.ENDED else each.end)
        return task

    def _finish(self, task: _Task, end: GoalEnd) -> None:
        """End a goal, unless a newer one has arrived."""
        with self._changed:
            if self._task is task:
                task.end = end
                self._replace(None)


def _text_of(error: Exception) -> str:
    if isinstance(error, IkservoError):
        return error.message
    return f"The motion failed: {type(error).__name__}: {error}"


class _Arrival:
    """Detector that tells whether joints have come to rest after the last setpoint."""

    def __init__(self) -> None:
        self._began_s: float | None = None
        self._still, self._moved = StillnessDetector(_STILL_S, _STILL_RAD), False

    def reached(self, now_s: float, positions: Vector) -> bool:
        """Check whether no joint has moved for a while, or the allowed time is over."""
        self._began_s = now_s if self._began_s is None else self._began_s
        self._still = self._still.add_joints(now_s, positions.tolist())
        self._moved = self._moved or self._still.has_moved()
        elapsed_s = now_s - self._began_s
        started = self._moved or elapsed_s > _START_S
        return (started and self._still.is_at_rest()) or elapsed_s > _MAX_ARRIVAL_S
