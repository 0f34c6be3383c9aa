"""The state of an arm as ROS 2 messages: joints, goals, link poses, health, description."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ikservo.control.joint_reading import JointState
from ikservo.kinematics import Chain
from ikservo.model import Model
from ikservo.ros_messages.link_transforms import LinkTransforms, quaternions
from ikservo.ros_messages.message_types import encode, make


@dataclass(frozen=True, slots=True)
class Topic:
    """A ROS 2 topic, with its leading slash; a latched topic keeps its last message."""

    name: str
    kind: str
    latched: bool = False


JOINT_STATES = Topic("/joint_states", "sensor_msgs/msg/JointState")
GOAL = Topic("/ikservo/goal", "sensor_msgs/msg/JointState")
TF = Topic("/tf", "tf2_msgs/msg/TFMessage")
DIAGNOSTICS = Topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
DESCRIPTION = Topic("/robot_description", "std_msgs/msg/String", latched=True)


@dataclass(frozen=True, slots=True)
class RosMessage:
    """An encoded ROS 2 message (CDR), with the time of its content, nanoseconds since 1970."""

    topic: Topic
    time_ns: int
    data: bytes


_OK, _WARN, _ERROR = 0, 1, 2


class ArmMessages:
    """Builder of an arm's messages."""

    def __init__(self, model: Model, chain: Chain) -> None:
        self._model, self._chain = model, chain
        self._names = tuple(joint.name for joint in model.joints)
        self._transforms = LinkTransforms(chain, self._names)
        self._servo_ids = {joint.name: joint.servo.id for joint in model.joints}

    def joint_states(self, time_ns: int, positions: Mapping[str, float]) -> RosMessage:
        """Return the message with measured positions, rad or m by joint."""
        return self._joints(JOINT_STATES, time_ns, positions)

    def goal(self, time_ns: int, positions: Mapping[str, float]) -> RosMessage:
        """Return the message with the servos' goals, rad or m by joint."""
        return self._joints(GOAL, time_ns, positions)

    def transforms(self, time_ns: int, positions: Mapping[str, float]) -> RosMessage:
        """Return the message with each link's pose in its parent, at positions of all joints."""
        T = self._transforms.poses(np.array([positions[name] for name in self._names]))
        turned = quaternions(T[:, :3, :3]).tolist()
        rows = [
            make(
                "geometry_msgs/msg/TransformStamped",
                header=_header(time_ns, parent),
                child_frame_id=child,
                transform=make(
                    "geometry_msgs/msg/Transform",
                    translation=make("geometry_msgs/msg/Vector3", x=x, y=y, z=z),
                    rotation=make("geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw),
                ),
            )
            for (parent, child), (x, y, z), (qx, qy, qz, qw) in zip(
                self._transforms.links, T[:, :3, 3].tolist(), turned, strict=True
            )
        ]
        return _message(TF, time_ns, transforms=rows)

    def diagnostics(
        self, time_ns: int, states: Sequence[JointState], stopped_for: str = "", warning: str = ""
    ) -> RosMessage:
        """Return the message with the health of the arm and of each servo."""
        own = self._status(
            self._model.name, self._model.title,
            _ERROR if stopped_for else _WARN if warning else _OK,
            stopped_for or warning or "ok",
            {"torque": _on_off(any(state.torque for state in states))},
        )  # fmt: skip
        status = [own, *map(self._servo_status, states)]
        return _message(DIAGNOSTICS, time_ns, header=_header(time_ns), status=status)

    def description(self, time_ns: int, urdf: str) -> RosMessage:
        """Return the message with the URDF."""
        return _message(DESCRIPTION, time_ns, data=urdf)

    def _joints(self, topic: Topic, time_ns: int, positions: Mapping[str, float]) -> RosMessage:
        values, none = np.array(list(positions.values()), dtype=np.float64), np.zeros(0)
        return _message(
            topic, time_ns, header=_header(time_ns, self._chain.base), name=list(positions),
            position=values, velocity=none, effort=none,
        )  # fmt: skip

    def _servo_status(self, state: JointState) -> object:
        level, text = _OK, "ok"
        if state.alarms:
            level, text = _ERROR, f"alarm: {', '.join(state.alarms)}"
        elif state.temperature_c >= self._model.health.warn_c:
            level, text = _WARN, f"{state.temperature_c:g} °C"
        values = {
            "temperature [°C]": f"{state.temperature_c:g}",
            "voltage [V]": f"{state.voltage_v:g}",
            "torque": _on_off(state.torque),
        }
        if state.load_percent is not None:
            values["load [%]"] = f"{state.load_percent:g}"
        if state.current_a is not None:
            values["current [A]"] = f"{state.current_a:g}"
        hardware = f"servo {self._servo_ids.get(state.name, '')}".rstrip()
        return self._status(f"{self._model.name}: {state.name}", hardware, level, text, values)

    def _status(
        self, name: str, hardware: str, level: int, text: str, values: Mapping[str, str]
    ) -> object:
        pairs = [make("diagnostic_msgs/msg/KeyValue", key=k, value=v) for k, v in values.items()]
        return make(
            "diagnostic_msgs/msg/DiagnosticStatus", level=level, name=name, message=text,
            hardware_id=hardware, values=pairs,
        )  # fmt: skip


def _message(topic: Topic, time_ns: int, **fields: object) -> RosMessage:
    return RosMessage(topic, time_ns, encode(topic.kind, make(topic.kind, **fields)))


def _header(time_ns: int, frame: str = "") -> Any:  # noqa: ANN401  # a generated class
    stamp = make(
        "builtin_interfaces/msg/Time", sec=time_ns // 1_000_000_000, nanosec=time_ns % 1_000_000_000
    )
    return make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def _on_off(on: bool) -> str:
    return "on" if on else "off"
