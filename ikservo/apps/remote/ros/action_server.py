"""The server of one ROS 2 action: goals and their states, three services and two topics.

Source: https://design.ros2.org/articles/actions.html
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, Protocol

import numpy as np

from ikservo.apps.remote.ros.node import Respond, RosNode
from ikservo.ros_messages.arm_messages import RosMessage, Topic
from ikservo.ros_messages.message_types import encode, make
from ikservo.ros_messages.service_types import CANCEL_GOAL

_STATUS = "action_msgs/msg/GoalStatusArray"
_MAX_ENDED = 64  # number of ended goals whose results are kept
_NS = 1_000_000_000
_ANY_GOAL = bytes(16)


class GoalStatus(IntEnum):
    """The state of a goal, with the numbers in action_msgs/msg/GoalStatus."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6

    @property
    def is_final(self) -> bool:
        """Whether the goal has ended."""
        return self >= GoalStatus.SUCCEEDED


class _CancelCode(IntEnum):
    """Answers to a cancel request, with the numbers in action_msgs/srv/CancelGoal."""

    NONE = 0
    UNKNOWN_GOAL_ID = 2
    GOAL_TERMINATED = 3


@dataclass(slots=True, eq=False)
class ActionGoal:
    """A goal from a client.

    Attributes:
        id: The id of 16 bytes, chosen by the client.
        time_ns: The time of its arrival, nanoseconds since 1970.
        status: The state of the goal.
        accepted: Whether it was accepted.
        result: The result, once the goal has ended.
    """

    id: bytes
    time_ns: int
    status: GoalStatus = GoalStatus.EXECUTING
    accepted: bool = True
    result: Any = None
    waiting: list[Respond] = field(default_factory=list[Respond])


class Executor(Protocol):
    """Object that executes goals and ends each of them with ``ActionServer.finish``."""

    def start(self, goal: ActionGoal, message: Any, /) -> Any:  # noqa: ANN401  # generated classes
        """Start executing a goal; return None, or the result of a refused goal."""
        ...

    def cancel(self, goal: ActionGoal, /) -> None:
        """Brake and hold; then end the goal."""
        ...

    def empty_result(self) -> Any:  # noqa: ANN401
        """Return the result of an unknown goal."""
        ...


class ActionServer:
    """Server that announces an action and stores the states and results of its goals.

    Args:
        node: The node.
        name: The name of the action, with a leading slash.
        kind: The type of the action, such as ``control_msgs/action/FollowJointTrajectory``.
        executor: Executes goals.
    """

    def __init__(self, node: RosNode, name: str, kind: str, executor: Executor) -> None:
        self._kind, self._executor, self._lock = kind, executor, threading.RLock()
        self._goals: dict[bytes, ActionGoal] = {}
        self._feedback_topic = Topic(f"{name}/_action/feedback", f"{kind}_FeedbackMessage")
        self._status_topic = Topic(f"{name}/_action/status", _STATUS, latched=True)
        self._publish_feedback = node.publisher(self._feedback_topic).publish
        self._publish_status = node.publisher(self._status_topic).publish
        node.serve(
            f"{name}/_action/send_goal", f"{kind}_SendGoal", self._answer_goal, in_order=True
        )
        node.serve(f"{name}/_action/cancel_goal", CANCEL_GOAL, self._answer_cancel)
        node.serve(f"{name}/_action/get_result", f"{kind}_GetResult", self._answer_result)
        self._say_status()

    def finish(self, goal: ActionGoal, status: GoalStatus, result: Any) -> None:  # noqa: ANN401
        """End a goal; a second call does nothing."""
        with self._lock:
            if goal.status.is_final:
                return
            goal.status, goal.result = status, result
            waiting, goal.waiting = goal.waiting, []
            self._say_status()
        for respond in waiting:
            respond(self._result_message(goal))

    def feedback(self, goal: ActionGoal, feedback: Any) -> None:  # noqa: ANN401
        """Publish the progress of a goal."""
        message = make(self._feedback_topic.kind, goal_id=_uuid(goal.id), feedback=feedback)
        data = encode(self._feedback_topic.kind, message)
        self._publish_feedback(RosMessage(self._feedback_topic, time.time_ns(), data))

    def _answer_goal(self, request: Any, respond: Respond) -> None:  # noqa: ANN401
        goal = ActionGoal(request.goal_id.uuid.tobytes(), time.time_ns())
        with self._lock:
            refused = goal.id in self._goals
            if not refused:
                self._goals[goal.id] = goal
                ended = [each.id for each in self._goals.values() if each.status.is_final]
                for old in ended[:-_MAX_ENDED]:
                    del self._goals[old]
        if not refused:
            refusal = self._executor.start(goal, request.goal)
            refused = refusal is not None
            if refused:
                goal.accepted = False
                self.finish(goal, GoalStatus.ABORTED, refusal)
            else:
                with self._lock:
                    self._say_status()
        stamp = time_message(goal.time_ns)
        respond(make(f"{self._kind}_SendGoal_Response", accepted=not refused, stamp=stamp))

    def _answer_result(self, request: Any, respond: Respond) -> None:  # noqa: ANN401
        with self._lock:
            goal = self._goals.get(request.goal_id.uuid.tobytes())
            if goal is not None and not goal.status.is_final:
                goal.waiting.append(respond)
                return
        respond(self._result_message(goal))

    def _result_message(self, goal: ActionGoal | None) -> Any:  # noqa: ANN401
        status = GoalStatus.UNKNOWN if goal is None else goal.status
        result = self._executor.empty_result() if goal is None else goal.result
        return make(f"{self._kind}_GetResult_Response", status=int(status), result=result)

    def _answer_cancel(self, request: Any, respond: Respond) -> None:  # noqa: ANN401
        stamp = request.goal_info.stamp
        wanted = request.goal_info.goal_id.uuid.tobytes()
        until_ns = int(stamp.sec) * _NS + int(stamp.nanosec)
        every = wanted == _ANY_GOAL and until_ns == 0
        with self._lock:
            chosen = [
                goal
                for goal in self._goals.values()
                if every or goal.id == wanted or 0 < goal.time_ns <= until_ns
            ]
            running = [goal for goal in chosen if not goal.status.is_final]
            for goal in running:
                goal.status = GoalStatus.CANCELING
            self._say_status()
        code = _CancelCode.NONE
        if not running and wanted != _ANY_GOAL:
            code = _CancelCode.GOAL_TERMINATED if chosen else _CancelCode.UNKNOWN_GOAL_ID
        for goal in running:
            self._executor.cancel(goal)
        rows = [_info(goal) for goal in running]
        respond(make(f"{CANCEL_GOAL}_Response", return_code=int(code), goals_canceling=rows))

    def _say_status(self) -> None:
        rows = [
            make("action_msgs/msg/GoalStatus", goal_info=_info(goal), status=int(goal.status))
            for goal in self._goals.values()
            if goal.accepted
        ]
        data = encode(_STATUS, make(_STATUS, status_list=rows))
        self._publish_status(RosMessage(self._status_topic, time.time_ns(), data))


def _uuid(number: bytes) -> Any:  # noqa: ANN401
    return make("unique_identifier_msgs/msg/UUID", uuid=np.frombuffer(number, dtype=np.uint8))


def _info(goal: ActionGoal) -> Any:  # noqa: ANN401
    stamp = time_message(goal.time_ns)
    return make("action_msgs/msg/GoalInfo", goal_id=_uuid(goal.id), stamp=stamp)


def time_message(time_ns: int) -> Any:  # noqa: ANN401
    """Return a time, in nanoseconds since 1970, as a message."""
    return make("builtin_interfaces/msg/Time", sec=time_ns // _NS, nanosec=time_ns % _NS)
