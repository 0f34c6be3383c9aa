"""Sends the setpoints of the newest goal to an arm, through its guard, until it has arrived."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np

from ikservo.arm import Arm, SetpointStream
from ikservo.errors import IkservoError, RefusedError
from ikservo.kinematics.arrays import Vector
from ikservo.network.ros.goals import MotionGoal

__all__ = ["GoalDriver"]

_PERIOD_S = 0.02
_STILL_RAD, _STILL_S = 0.002, 0.3  # no joint moved further in this time: it has arrived
_START_S = 2.0  # until when the arm moves at the latest, its torque being switched on before
_MAX_ARRIVAL_S = 30.0


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
        self._goal: MotionGoal | None = None
        self._busy = self._closing = False
        self._thread = threading.Thread(target=self._run, name="ikservo-ros-goals", daemon=True)
        self._thread.start()

    @property
    def goal(self) -> MotionGoal | None:
        """Return the goal that is being followed."""
        return self._goal

    @property
    def is_moving(self) -> bool:
        """Return whether the arm moves, or brakes."""
        return self._busy

    def put(self, goal: MotionGoal | None) -> None:
        """Replace the goal; None brakes and holds."""
        with self._changed:
            self._goal = goal
            self._changed.notify_all()

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
            self._closing, self._goal = True, None
            self._changed.notify_all()
        self._thread.join(10.0)

    def _run(self) -> None:
        while self._await_goal():
            try:
                with self._arm.stream(speed=self._speed) as stream:
                    self._follow(stream)
                if stream.reason:
                    self._warn(stream.reason)
                elif stream.unreached:
                    self._warn("The goal is out of reach; the arm went as near as it could.")
            except Exception as error:  # this thread must not end: nobody would drive the arm
                self.put(None)
                self._warn(_text_of(error))
            finally:
                with self._changed:
                    self._busy = False
                    self._changed.notify_all()

    def _await_goal(self) -> bool:
        """Wait for a goal; return False once closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._closing or self._goal is not None)
            self._busy = self._goal is not None
            return not self._closing

    def _follow(self, stream: SetpointStream) -> None:
        """Send setpoints until the newest goal has ended and the arm is still, or none is left."""
        still = _Stillness()
        due_s = began_s = time.monotonic()
        while (goal := self._goal) is not None:
            now_s, state = time.monotonic(), self._arm.where()
            if not _is_running(stream, now_s - began_s):
                goal.delay(now_s)
            ended = goal.has_ended(now_s)
            stream.send(goal.setpoint(now_s, state.tip_m))
            if not ended:
                still = _Stillness()
            elif not goal.arrives or still.reached(now_s, state.positions_rad):
                self._finish(goal)
            due_s = max(due_s + _PERIOD_S, now_s)
            time.sleep(max(0.0, due_s - time.monotonic()))

    def _finish(self, goal: MotionGoal) -> None:
        with self._changed:
            if self._goal is goal:  # no newer one came meanwhile
                self._goal = None


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
