"""The action FollowJointTrajectory: a joint trajectory with tolerances, and its result.

A position tolerance [rad or m] above 0 is used as given; 0 means the default; below 0, no limit.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum
from typing import Any

import numpy as np

from ikservo.apps.remote.ros.action_server import ActionGoal, ActionServer, GoalStatus, time_message
from ikservo.apps.remote.ros.goal_driver import GoalDriver, GoalEnd
from ikservo.apps.remote.ros.goals import TrajectoryGoal, check_age
from ikservo.apps.remote.ros.node import RosNode
from ikservo.arm import OpenArm
from ikservo.errors import BadValueError, IkservoError, InputError, RefusedError
from ikservo.ros_messages.message_types import make
from ikservo.ros_messages.service_types import FOLLOW

ACTION = "/joint_trajectory_controller/follow_joint_trajectory"
"""Name of the action, which is the default in ros2_control."""

_FEEDBACK_PERIOD_S = 0.1
_GOAL_TOLERANCE_RAD, _GOAL_TOLERANCE_M = 0.05, 0.005


class ErrorCode(IntEnum):
    """The error codes of the action's result."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class TrajectoryAction:
    """Server that announces the action and drives the arm along its newest goal.

    Args:
        node: The node.
        arm: The arm.
        driver: Drives the arm.
        parse: Returns the goal in a trajectory message; raises an error if the goal cannot be used
            or the arm may not move.
    """

    def __init__(
        self,
        node: RosNode,
        arm: OpenArm,
        driver: GoalDriver,
        parse: Callable[[Any], TrajectoryGoal],
    ) -> None:
        self._arm, self._driver, self._parse = arm, driver, parse
        self._watches: dict[ActionGoal, _Watch] = {}
        self._lock = threading.Lock()
        self.server = ActionServer(node, ACTION, FOLLOW, self)

    def start(self, goal: ActionGoal, message: Any) -> Any:  # noqa: ANN401  # generated classes
        """Start a goal; return None, or the result of a refused goal."""
        try:
            watch = self._make_watch(goal, message)
        except _InvalidJointsError as error:
            return _result(ErrorCode.INVALID_JOINTS, error.message)
        except _OldError as error:
            return _result(ErrorCode.OLD_HEADER_TIMESTAMP, error.message)
        except IkservoError as error:
            return _result(ErrorCode.INVALID_GOAL, error.message)
        with self._lock:
            self._watches[goal] = watch
        self._driver.put(watch.trajectory, watch)
        if goal.status is GoalStatus.CANCELING:  # cancelled meanwhile
            self._driver.cancel(watch)
        return None

    def cancel(self, goal: ActionGoal) -> None:
        """Brake and hold; the goal ends once the arm is at rest."""
        with self._lock:
            watch = self._watches.get(goal)
        if watch is not None:
            self._driver.cancel(watch)

    def empty_result(self) -> Any:  # noqa: ANN401
        """Return the result of an unknown goal."""
        return _result(ErrorCode.INVALID_GOAL, "There is no such goal, or it has ended.")

    def finish(self, goal: ActionGoal, status: GoalStatus, code: ErrorCode, text: str) -> None:
        """End a goal."""
        with self._lock:
            self._watches.pop(goal, None)
        self.server.finish(goal, status, _result(code, text))

    def _make_watch(self, goal: ActionGoal, message: Any) -> _Watch:  # noqa: ANN401
        trajectory = message.trajectory
        names = tuple(trajectory.joint_names)
        _check_joints(names, message, self._arm.joint_names)
        try:
            check_age(trajectory.header.stamp, time.time())
        except RefusedError as error:
            raise _OldError(error.command_message, error.command_hint) from None
        if not trajectory.points:
            raise InputError("The trajectory has no points.", "Nothing moved.")
        units = {joint.name: joint.joint_map.unit for joint in self._arm.model.joints}
        usual = {name: _GOAL_TOLERANCE_M if units[name] == "m" else _GOAL_TOLERANCE_RAD
                 for name in names}  # fmt: skip
        at_end = _tolerances(message.goal_tolerance, usual)
        on_path = _tolerances(message.path_tolerance, dict.fromkeys(names, math.inf))
        tolerance = message.goal_time_tolerance
        timeout_s = float(tolerance.sec) + 1e-9 * float(tolerance.nanosec)
        return _Watch(self, goal, self._arm, self._parse(trajectory), on_path, at_end, timeout_s)


class _InvalidJointsError(InputError):
    pass


class _OldError(RefusedError):
    pass


def _check_joints(names: Sequence[str], message: Any, known: Sequence[str]) -> None:  # noqa: ANN401
    """Refuse a goal or tolerances with joints that the arm does not have."""
    rows = (*message.path_tolerance, *message.goal_tolerance)
    unknown = [name for name in names if name not in known]
    unknown += [row.name for row in rows if row.name not in names]
    unknown += list(message.multi_dof_trajectory.joint_names)
    unknown += [row.joint_name for row in (*message.component_path_tolerance,
                                           *message.component_goal_tolerance)]  # fmt: skip
    if unknown or not names or len(set(names)) != len(names):
        found = ", ".join(map(repr, unknown or names)) or "none"
        hint = f"Expected each joint once: {', '.join(known)}."
        raise _InvalidJointsError(f"The joints of the goal cannot be used: {found}.", hint)


def _tolerances(rows: Sequence[Any], usual: Mapping[str, float]) -> dict[str, float]:
    """Compute the maximum allowed deviation of each joint, rad or m."""
    found = dict(usual)
    for row in rows:
        if math.isnan(row.position):
            raise BadValueError(f"The tolerance of {row.name}", row.position, "a number")
        if row.position != 0.0:
            found[row.name] = row.position if row.position > 0.0 else math.inf
    return found


class _Watch:
    """Watcher that compares measured and desired positions, and ends the goal."""

    def __init__(
        self,
        action: TrajectoryAction,
        goal: ActionGoal,
        arm: OpenArm,
        trajectory: TrajectoryGoal,
        on_path: Mapping[str, float],
        at_end: Mapping[str, float],
        timeout_s: float,
    ) -> None:
        self._action, self._goal, self._arm = action, goal, arm
        self.trajectory = trajectory
        self._on_path, self._at_end, self._timeout_s = on_path, at_end, timeout_s
        self._violation: tuple[ErrorCode, str] | None = None
        self._said_s = -math.inf

    def observe(self, now_s: float, positions: Mapping[str, float]) -> bool:
        """Receive measured positions; return whether to go on."""
        desired = self.trajectory.positions_at(now_s)
        if now_s - self._said_s >= _FEEDBACK_PERIOD_S:
            self._said_s = now_s
            self._action.server.feedback(self._goal, _feedback(desired, positions))
        if not self.trajectory.has_ended(now_s):
            self._violation = self._check(
                ErrorCode.PATH_TOLERANCE_VIOLATED, desired, positions, self._on_path
            )
        elif 0.0 < self._timeout_s <= self.trajectory.late_s(now_s):
            self._violation = self._check_end(positions)
        return self._violation is None

    def ended(self, end: GoalEnd, why: str) -> None:
        """End the goal; the arm is at rest, or another goal has replaced this goal."""
        if end is GoalEnd.ARRIVED:
            try:
                self._violation = self._check_end(self._arm.where().positions)
            except IkservoError as error:  # a servo is silent, so the position is unknown
                end, why = GoalEnd.FAILED, error.message
        if self._violation is not None:
            code, text = self._violation
            self._abort(code, f"{text} {why}".strip())
        elif end is GoalEnd.ARRIVED:
            self._action.finish(self._goal, GoalStatus.SUCCEEDED, ErrorCode.SUCCESSFUL, "")
        elif end is GoalEnd.REPLACED:
            self._abort(ErrorCode.INVALID_GOAL, "A newer goal has replaced this one.")
        elif self._goal.status is GoalStatus.CANCELING:
            text = why or "The goal was cancelled; the arm holds its position."
            self._action.finish(self._goal, GoalStatus.CANCELED, ErrorCode.SUCCESSFUL, text)
        else:
            text = why or "The motion was ended; the arm holds its position."
            self._abort(ErrorCode.PATH_TOLERANCE_VIOLATED, text)

    def _abort(self, code: ErrorCode, text: str) -> None:
        self._action.finish(self._goal, GoalStatus.ABORTED, code, text)

    def _check_end(self, positions: Mapping[str, float]) -> tuple[ErrorCode, str] | None:
        end = self.trajectory.positions_at(math.inf)
        return self._check(ErrorCode.GOAL_TOLERANCE_VIOLATED, end, positions, self._at_end)

    def _check(
        self,
        code: ErrorCode,
        desired: Mapping[str, float],
        positions: Mapping[str, float],
        tolerances: Mapping[str, float],
    ) -> tuple[ErrorCode, str] | None:
        for name, at in desired.items():
            off = abs(at - positions[name])
            if off > tolerances[name]:
                return code, f"{name} is off by {off:.4f}, more than {tolerances[name]:g}."
        return None


def _result(code: ErrorCode, text: str) -> Any:  # noqa: ANN401
    return make(f"{FOLLOW}_Result", error_code=int(code), error_string=text)


def _feedback(desired: Mapping[str, float], positions: Mapping[str, float]) -> Any:  # noqa: ANN401
    goal = np.array(list(desired.values()))
    actual = np.array([positions[name] for name in desired])
    nowhere = {
        f"multi_dof_{part}": make(
            "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint", transforms=[], velocities=[],
            accelerations=[], time_from_start=_no_time(),
        )
        for part in ("desired", "actual", "error")
    }  # fmt: skip
    header = make("std_msgs/msg/Header", stamp=time_message(time.time_ns()), frame_id="")
    return make(
        f"{FOLLOW}_Feedback", header=header, joint_names=list(desired), desired=_point(goal),
        actual=_point(actual), error=_point(goal - actual), multi_dof_joint_names=[], **nowhere,
    )  # fmt: skip


def _point(positions: Any) -> Any:  # noqa: ANN401
    none = np.zeros(0)
    return make(
        "trajectory_msgs/msg/JointTrajectoryPoint", positions=positions, velocities=none,
        accelerations=none, effort=none, time_from_start=_no_time(),
    )  # fmt: skip


def _no_time() -> Any:  # noqa: ANN401
    return make("builtin_interfaces/msg/Duration", sec=0, nanosec=0)
