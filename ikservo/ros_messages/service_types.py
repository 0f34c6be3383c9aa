"""Types of ROS 2 Jazzy that rosbags does not contain: services and the trajectory action.

For its hash, a service is described as a message with request, response and event, and an action as
two services and a message that contain the goal's id.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rosbags.interfaces import Nodetype
    from rosbags.interfaces.typing import FieldDesc, Typesdict

TRIGGER = "std_srvs/srv/Trigger"
CANCEL_GOAL = "action_msgs/srv/CancelGoal"
FOLLOW = "control_msgs/action/FollowJointTrajectory"
EVENT_INFO = "service_msgs/msg/ServiceEventInfo"

_TRAJECTORY = "trajectory_msgs/msg"
_BASES = ("bool", "int8", "uint8", "uint16", "int32", "int64", "float64", "string")
_DURATION, _TIME = "builtin_interfaces/msg/Duration", "builtin_interfaces/msg/Time"
_GOAL_INFO, _UUID = "action_msgs/msg/GoalInfo", "unique_identifier_msgs/msg/UUID"
_JOINT_TOLERANCE = "control_msgs/msg/JointTolerance"
_COMPONENT_TOLERANCE = "control_msgs/msg/JointComponentTolerance"

Fields = Mapping[str, str]
"""Type of each field; ``[]`` marks a sequence, ``[<=1]`` at most one item, ``[16]`` 16 items."""

_MESSAGES: Mapping[str, Fields] = {
    EVENT_INFO: {
        "event_type": "uint8", "stamp": _TIME, "client_gid": "uint8[16]",
        "sequence_number": "int64",
    },
    _JOINT_TOLERANCE: {
        "name": "string", "position": "float64", "velocity": "float64", "acceleration": "float64",
    },
    _COMPONENT_TOLERANCE: {
        "joint_name": "string", "component": "uint16", "position": "float64",
        "velocity": "float64", "acceleration": "float64",
    },
    f"{FOLLOW}_Goal": {
        "trajectory": f"{_TRAJECTORY}/JointTrajectory",
        "multi_dof_trajectory": f"{_TRAJECTORY}/MultiDOFJointTrajectory",
        "path_tolerance": f"{_JOINT_TOLERANCE}[]",
        "component_path_tolerance": f"{_COMPONENT_TOLERANCE}[]",
        "goal_tolerance": f"{_JOINT_TOLERANCE}[]",
        "component_goal_tolerance": f"{_COMPONENT_TOLERANCE}[]",
        "goal_time_tolerance": _DURATION,
    },
    f"{FOLLOW}_Result": {"error_code": "int32", "error_string": "string"},
    f"{FOLLOW}_Feedback": {
        "header": "std_msgs/msg/Header",
        "joint_names": "string[]",
        "desired": f"{_TRAJECTORY}/JointTrajectoryPoint",
        "actual": f"{_TRAJECTORY}/JointTrajectoryPoint",
        "error": f"{_TRAJECTORY}/JointTrajectoryPoint",
        "multi_dof_joint_names": "string[]",
        "multi_dof_desired": f"{_TRAJECTORY}/MultiDOFJointTrajectoryPoint",
        "multi_dof_actual": f"{_TRAJECTORY}/MultiDOFJointTrajectoryPoint",
        "multi_dof_error": f"{_TRAJECTORY}/MultiDOFJointTrajectoryPoint",
    },
    f"{FOLLOW}_FeedbackMessage": {"goal_id": _UUID, "feedback": f"{FOLLOW}_Feedback"},
}  # fmt: skip

_SERVICES: Mapping[str, tuple[Fields, Fields]] = {
    TRIGGER: ({}, {"success": "bool", "message": "string"}),
    CANCEL_GOAL: (
        {"goal_info": _GOAL_INFO},
        {"return_code": "int8", "goals_canceling": f"{_GOAL_INFO}[]"},
    ),
    f"{FOLLOW}_SendGoal": (
        {"goal_id": _UUID, "goal": f"{FOLLOW}_Goal"},
        {"accepted": "bool", "stamp": _TIME},
    ),
    f"{FOLLOW}_GetResult": ({"goal_id": _UUID}, {"status": "int8", "result": f"{FOLLOW}_Result"}),
}


def service_types(node: type[Nodetype]) -> Typesdict:
    """Return the types, as rosbags describes them."""
    messages = dict(_MESSAGES)
    for name, (request, response) in _SERVICES.items():
        messages[f"{name}_Request"], messages[f"{name}_Response"] = request, response
        messages[f"{name}_Event"] = {
            "info": EVENT_INFO,
            "request": f"{name}_Request[<=1]",
            "response": f"{name}_Response[<=1]",
        }
        messages[name] = {
            "request_message": f"{name}_Request",
            "response_message": f"{name}_Response",
            "event_message": f"{name}_Event",
        }
    return {
        name: ([], [(field, _describe(node, kind)) for field, kind in fields.items()])
        for name, fields in messages.items()
    }


def _describe(node: type[Nodetype], kind: str) -> FieldDesc:
    name, bracket, count = kind.removesuffix("]").partition("[")
    one: FieldDesc = (node.BASE, (name, 0)) if name in _BASES else (node.NAME, name)
    if not bracket:
        return one
    if count.isdecimal():
        return node.ARRAY, (one, int(count))
    return node.SEQUENCE, (one, int(count.removeprefix("<=") or 0))
