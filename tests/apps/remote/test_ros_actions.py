"""The action FollowJointTrajectory: a client of another implementation sends and cancels goals."""

import os
import struct
import threading
import time
from dataclasses import dataclass, field

import numpy as np
import pytest
import zenoh
from ros2_pyterfaces.cyclone.builtin_interfaces.msg import Duration, Time
from ros2_pyterfaces.cyclone.idl import IdlStruct, make_idl_service, types
from ros2_pyterfaces.cyclone.std_msgs.msg import Header
from ros2_pyterfaces.cyclone.trajectory_msgs.msg import (
    JointTrajectory,
    JointTrajectoryPoint,
    MultiDOFJointTrajectory,
    MultiDOFJointTrajectoryPoint,
)
from ros2_pyterfaces.cyclone.unique_identifier_msgs.msg import UUID

from ikservo.apps.remote.ros.action_server import GoalStatus
from ikservo.apps.remote.ros.trajectory_action import ACTION, ErrorCode
from ikservo.ros_messages.message_types import type_hash
from ikservo.ros_messages.service_types import CANCEL_GOAL, FOLLOW
from tests.apps.remote.conftest import until
from tests.apps.remote.ros_graph import trajectory
from tests.arm.simulated import true_joints

JOINT = "wrist_roll"


@dataclass
class JointTolerance(IdlStruct, typename="control_msgs/msg/JointTolerance"):
    name: str = ""
    position: types.float64 = 0.0
    velocity: types.float64 = 0.0
    acceleration: types.float64 = 0.0


@dataclass
class JointComponentTolerance(IdlStruct, typename="control_msgs/msg/JointComponentTolerance"):
    joint_name: str = ""
    component: types.uint16 = 0
    position: types.float64 = 0.0
    velocity: types.float64 = 0.0
    acceleration: types.float64 = 0.0


@dataclass
class Goal(IdlStruct, typename=f"{FOLLOW}_Goal"):
    trajectory: JointTrajectory = field(default_factory=JointTrajectory)
    multi_dof_trajectory: MultiDOFJointTrajectory = field(default_factory=MultiDOFJointTrajectory)
    path_tolerance: types.sequence[JointTolerance] = field(default_factory=list)
    component_path_tolerance: types.sequence[JointComponentTolerance] = field(default_factory=list)
    goal_tolerance: types.sequence[JointTolerance] = field(default_factory=list)
    component_goal_tolerance: types.sequence[JointComponentTolerance] = field(default_factory=list)
    goal_time_tolerance: Duration = field(default_factory=Duration)


@dataclass
class Result(IdlStruct, typename=f"{FOLLOW}_Result"):
    error_code: types.int32 = 0
    error_string: str = ""


@dataclass
class Feedback(IdlStruct, typename=f"{FOLLOW}_Feedback"):
    header: Header = field(default_factory=Header)
    joint_names: types.sequence[str] = field(default_factory=list)
    desired: JointTrajectoryPoint = field(default_factory=JointTrajectoryPoint)
    actual: JointTrajectoryPoint = field(default_factory=JointTrajectoryPoint)
    error: JointTrajectoryPoint = field(default_factory=JointTrajectoryPoint)
    multi_dof_joint_names: types.sequence[str] = field(default_factory=list)
    multi_dof_desired: MultiDOFJointTrajectoryPoint = field(
        default_factory=MultiDOFJointTrajectoryPoint
    )
    multi_dof_actual: MultiDOFJointTrajectoryPoint = field(
        default_factory=MultiDOFJointTrajectoryPoint
    )
    multi_dof_error: MultiDOFJointTrajectoryPoint = field(
        default_factory=MultiDOFJointTrajectoryPoint
    )


@dataclass
class FeedbackMessage(IdlStruct, typename=f"{FOLLOW}_FeedbackMessage"):
    goal_id: UUID = field(default_factory=UUID)
    feedback: Feedback = field(default_factory=Feedback)


@dataclass
class SendGoalRequest(IdlStruct, typename=f"{FOLLOW}_SendGoal_Request"):
    goal_id: UUID = field(default_factory=UUID)
    goal: Goal = field(default_factory=Goal)


@dataclass
class SendGoalResponse(IdlStruct, typename=f"{FOLLOW}_SendGoal_Response"):
    accepted: bool = False
    stamp: Time = field(default_factory=Time)


@dataclass
class GetResultRequest(IdlStruct, typename=f"{FOLLOW}_GetResult_Request"):
    goal_id: UUID = field(default_factory=UUID)


@dataclass
class GetResultResponse(IdlStruct, typename=f"{FOLLOW}_GetResult_Response"):
    status: types.int8 = 0
    result: Result = field(default_factory=Result)


@dataclass
class GoalInfo(IdlStruct, typename="action_msgs/msg/GoalInfo"):
    goal_id: UUID = field(default_factory=UUID)
    stamp: Time = field(default_factory=Time)


@dataclass
class GoalState(IdlStruct, typename="action_msgs/msg/GoalStatus"):
    goal_info: GoalInfo = field(default_factory=GoalInfo)
    status: types.int8 = 0


@dataclass
class GoalStatusArray(IdlStruct, typename="action_msgs/msg/GoalStatusArray"):
    status_list: types.sequence[GoalState] = field(default_factory=list)


@dataclass
class CancelRequest(IdlStruct, typename=f"{CANCEL_GOAL}_Request"):
    goal_info: GoalInfo = field(default_factory=GoalInfo)


@dataclass
class CancelResponse(IdlStruct, typename=f"{CANCEL_GOAL}_Response"):
    return_code: types.int8 = 0
    goals_canceling: types.sequence[GoalInfo] = field(default_factory=list)


SEND_GOAL = make_idl_service(SendGoalRequest, SendGoalResponse, typename=f"{FOLLOW}_SendGoal")
GET_RESULT = make_idl_service(GetResultRequest, GetResultResponse, typename=f"{FOLLOW}_GetResult")
CANCEL = make_idl_service(CancelRequest, CancelResponse, typename=CANCEL_GOAL)


class Client:
    """A client of the action.

    Attributes:
        feedback: The received feedback.
        states: The latest status of each goal, by its id.
    """

    def __init__(self, graph, stack_of_subscribers):
        self._graph, self._gid, self._sent = graph, os.urandom(16), 0
        self._session = graph._session
        self.feedback, self.states = [], {}
        for name, kind, take in (
            ("feedback", FeedbackMessage, self.feedback.append),
            ("status", GoalStatusArray, self._take_status),
        ):
            key = graph.key(f"{ACTION}/_action/{name}", kind)
            stack_of_subscribers.append(self._session.declare_subscriber(
                key, lambda sample, kind=kind, take=take: take(
                    kind.deserialize(sample.payload.to_bytes()))))  # fmt: skip

    def _take_status(self, message):
        self.states |= {
            bytes(each.goal_info.goal_id.uuid): each.status for each in message.status_list
        }

    def call(self, name, service, request):
        self._sent += 1
        attachment = struct.pack("<qqB16s", self._sent, time.time_ns(), 16, self._gid)
        (reply,) = self._session.get(
            self._graph.key(f"{ACTION}/_action/{name}", service), payload=request.serialize(),
            attachment=attachment, target=zenoh.QueryTarget.ALL_COMPLETE, timeout=120.0,
        )  # fmt: skip
        return service.Response.deserialize(reply.ok.payload.to_bytes())

    def send(self, goal, number=None):
        """Send a goal; return its id and whether it was accepted."""
        number = number or os.urandom(16)
        request = SendGoalRequest(goal_id=UUID(uuid=number), goal=goal)
        return number, self.call("send_goal", SEND_GOAL, request).accepted

    def result(self, number):
        """Wait for the end of a goal; return its state, its code and its text."""
        found = self.call("get_result", GET_RESULT, GetResultRequest(goal_id=UUID(uuid=number)))
        return GoalStatus(found.status), ErrorCode(found.result.error_code), (
            found.result.error_string)  # fmt: skip

    def cancel(self, number):
        info = GoalInfo(goal_id=UUID(uuid=number))
        return self.call("cancel_goal", CANCEL, CancelRequest(goal_info=info))


@pytest.fixture
def client(graph):
    subscribers = []
    yield Client(graph, subscribers)
    for each in subscribers:
        each.undeclare()


@pytest.fixture
def start(graph):
    return true_joints(graph.arm)[JOINT]


def goal_to(*points, **more):
    return Goal(trajectory=trajectory(JOINT, *points), **more)


@pytest.mark.parametrize(
    ("kind", "theirs"),
    [
        (f"{FOLLOW}_SendGoal", SEND_GOAL),
        (f"{FOLLOW}_GetResult", GET_RESULT),
        (f"{FOLLOW}_FeedbackMessage", FeedbackMessage),
        ("action_msgs/msg/GoalStatusArray", GoalStatusArray),
        (CANCEL_GOAL, CANCEL),
    ],
)
def test_ros_type_hashes_match_other_ros_implementation(kind, theirs):
    assert type_hash(kind) == theirs.hash_rihs01()


def test_ros_action_hashes_match_ros_2():
    cancel = "RIHS01_573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a"
    status = "RIHS01_6c1684b00f177d37438febe6e709fc4e2b0d4248dca4854946f9ed8b30cda83e"
    assert type_hash(CANCEL_GOAL) == cancel
    assert type_hash("action_msgs/msg/GoalStatusArray") == status


@pytest.mark.full
def test_ros_action_goal_succeeds_with_feedback(graph, client, start):
    number, accepted = client.send(goal_to((1.0, start + 0.2), (2.0, start + 0.3)))
    assert accepted
    assert client.result(number)[:2] == (GoalStatus.SUCCEEDED, ErrorCode.SUCCESSFUL)
    assert true_joints(graph.arm)[JOINT] == pytest.approx(start + 0.3, abs=0.03)
    until(lambda: client.feedback)  # which may come later than the result
    last = client.feedback[-1]
    assert (bytes(last.goal_id.uuid), last.feedback.joint_names) == (number, [JOINT])
    np.testing.assert_allclose(
        last.feedback.error.positions,
        np.subtract(last.feedback.desired.positions, last.feedback.actual.positions),
    )
    until(lambda: client.states[number] == GoalStatus.SUCCEEDED)


@pytest.mark.parametrize(
    ("change", "code", "text"),
    [
        ({"trajectory": trajectory("elbow", (1.0, 0.1))}, ErrorCode.INVALID_JOINTS, "elbow"),
        ({"trajectory": JointTrajectory()}, ErrorCode.INVALID_JOINTS, "none"),
        ({"path_tolerance": [JointTolerance(name="x")]}, ErrorCode.INVALID_JOINTS, "x"),
        ({"multi_dof_trajectory": MultiDOFJointTrajectory(joint_names=["base"])},
         ErrorCode.INVALID_JOINTS, "base"),
        ({"trajectory": JointTrajectory(joint_names=[JOINT])}, ErrorCode.INVALID_GOAL, "points"),
        ({"trajectory": trajectory(JOINT, (1.0, 9.0))}, ErrorCode.INVALID_GOAL, "outside"),
        ({"trajectory": trajectory(JOINT, (1.0, 0.1), (0.5, 0.2))}, ErrorCode.INVALID_GOAL,
         "not increasing"),
        ({"goal_tolerance": [JointTolerance(name=JOINT, position=np.nan)]},
         ErrorCode.INVALID_GOAL, "tolerance"),
    ],
)  # fmt: skip
def test_invalid_ros_action_goal_is_rejected_with_error_code(graph, client, change, code, text):
    number, accepted = client.send(Goal(**{"trajectory": trajectory(JOINT, (1.0, 0.1)), **change}))
    assert not accepted
    status, found, why = client.result(number)
    assert (status, found, text in why) == (GoalStatus.ABORTED, code, True), why
    assert not graph.bridge._driver.is_moving


def test_outdated_ros_action_goal_is_rejected(client):
    old = trajectory(JOINT, (1.0, 0.1))
    old.header.stamp = Time(sec=int(time.time()) - 10)
    number, accepted = client.send(Goal(trajectory=old))
    assert (accepted, client.result(number)[1]) == (False, ErrorCode.OLD_HEADER_TIMESTAMP)


@pytest.mark.full
def test_repeated_ros_action_goal_is_rejected_and_first_runs_on(client, start):
    number, _ = client.send(goal_to((1.0, start + 0.2)))
    assert client.send(goal_to((1.0, start - 0.2)), number) == (number, False)
    assert client.result(number)[0] is GoalStatus.SUCCEEDED


def test_ros_motion_outside_path_tolerance_is_aborted(graph, client, start):
    far = start - 1.5 if start > 0 else start + 1.5
    at_once = [JointTolerance(name=JOINT, position=0.1)]
    number, accepted = client.send(goal_to((0.1, far), (9.0, far), path_tolerance=at_once))
    assert accepted
    status, code, text = client.result(number)
    assert (status, code) == (GoalStatus.ABORTED, ErrorCode.PATH_TOLERANCE_VIOLATED)
    assert JOINT in text
    assert abs(true_joints(graph.arm)[JOINT] - far) > 0.5
    assert graph.arm.stop_reason is None


@pytest.mark.campaign
def test_ros_motion_outside_goal_tolerance_is_aborted(client, start):
    exact = [JointTolerance(name=JOINT, position=1e-9)]
    number, _ = client.send(goal_to((0.5, start + 0.1), goal_tolerance=exact))
    assert client.result(number)[:2] == (GoalStatus.ABORTED, ErrorCode.GOAL_TOLERANCE_VIOLATED)


def test_ros_motion_beyond_goal_time_tolerance_is_aborted(client, start):
    far = start - 1.5 if start > 0 else start + 1.5
    tolerance = Duration(sec=0, nanosec=100_000_000)
    number, _ = client.send(goal_to((0.1, far), goal_time_tolerance=tolerance))
    assert client.result(number)[:2] == (GoalStatus.ABORTED, ErrorCode.GOAL_TOLERANCE_VIOLATED)


def test_canceled_ros_action_goal_ends_and_arm_holds(graph, client, start):
    number, _ = client.send(goal_to((20.0, start + 1.0)))
    until(lambda: true_joints(graph.arm)[JOINT] > start + 0.05)
    answer = client.cancel(number)
    assert answer.return_code == 0
    assert [bytes(each.goal_id.uuid) for each in answer.goals_canceling] == [number]
    assert client.result(number)[0] is GoalStatus.CANCELED
    held = true_joints(graph.arm)[JOINT]
    assert held < start + 0.6
    assert not graph.bridge._driver.is_moving
    assert graph.arm.stop_reason is None
    assert client.cancel(number).return_code == 3  # it has ended
    assert client.cancel(os.urandom(16)).return_code == 2  # there is none


@pytest.mark.full
def test_newer_ros_action_goal_replaces_older_one(graph, client, start):
    first, _ = client.send(goal_to((20.0, start + 1.0)))
    until(lambda: true_joints(graph.arm)[JOINT] > start + 0.05)
    second, _ = client.send(goal_to((0.5, start)))
    status, code, text = client.result(first)
    assert (status, code) == (GoalStatus.ABORTED, ErrorCode.INVALID_GOAL)
    assert "newer goal" in text
    assert client.result(second)[0] is GoalStatus.SUCCEEDED
    assert true_joints(graph.arm)[JOINT] == pytest.approx(start, abs=0.03)


@pytest.mark.full
def test_stop_aborts_ros_goal_and_rejects_next_one(graph, client, start):
    number, _ = client.send(goal_to((20.0, start + 1.0)))
    until(lambda: true_joints(graph.arm)[JOINT] > start + 0.05)
    ends = []
    waiting = threading.Thread(target=lambda: ends.append(client.result(number)))
    waiting.start()
    assert graph.call("/stop")[0].success
    waiting.join(60.0)
    assert ends[0][0] is GoalStatus.ABORTED
    assert "ROS 2" in ends[0][2]
    number, accepted = client.send(goal_to((0.5, start)))
    assert (accepted, client.result(number)[1]) == (False, ErrorCode.INVALID_GOAL)


def test_result_of_unknown_ros_goal_has_status_unknown(client):
    assert client.result(os.urandom(16))[0] is GoalStatus.UNKNOWN
