"""An arm as a ROS 2 node, which publishes states, accepts goals and stops."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, suppress
from typing import TYPE_CHECKING, Any

import numpy as np

from ikservo.apps.remote.ros.goal_driver import GoalDriver
from ikservo.apps.remote.ros.goals import (
    MotionGoal,
    TrajectoryGoal,
    TwistGoal,
    check_age,
    pose_goal,
    trajectory_goal,
)
from ikservo.apps.remote.ros.node import RosNode
from ikservo.apps.remote.ros.trajectory_action import TrajectoryAction
from ikservo.apps.remote.ros.wire import NodeName
from ikservo.arm import ArmState, JointState, OpenArm, StopKind, StopReason
from ikservo.errors import BadValueError, IkservoError, RefusedError, shown
from ikservo.model.model_loading import description_text
from ikservo.planning.reports import describe_torque
from ikservo.ros_messages.arm_messages import (
    DESCRIPTION,
    DIAGNOSTICS,
    JOINT_STATES,
    TF,
    ArmMessages,
    RosMessage,
    Topic,
)

if TYPE_CHECKING:
    import zenoh

TRAJECTORY = Topic("/joint_trajectory", "trajectory_msgs/msg/JointTrajectory")
TWIST = Topic("/servo_twist", "geometry_msgs/msg/TwistStamped")
POSE = Topic("/target_pose", "geometry_msgs/msg/PoseStamped")

OUTPUTS = (JOINT_STATES, TF, DESCRIPTION, DIAGNOSTICS)
INPUTS = (TRAJECTORY, TWIST, POSE)
SERVICES = ("/stop", "/hold", "/acknowledge")

_DIAGNOSTICS_PERIOD_S = 1.0
_ROUTER_PERIOD_S = 0.05
_BRAKE_TIMEOUT_S = 2.0


class RosBridge:
    """Connection of an open arm to a ROS 2 graph until the bridge is closed.

    Args:
        session: A Zenoh session with a router; the caller closes it after the bridge.
        arm: The arm; the caller closes it after the bridge.
        domain: The domain of ROS 2.
        namespace: The namespace for all names; empty for none.
        rate_hz: The number of joint states per second that are published.
        speed: The speed class of all motions.
        warn: Called with each refusal and its reason.
    """

    def __init__(
        self,
        session: zenoh.Session,
        arm: OpenArm,
        domain: int = 0,
        namespace: str = "",
        rate_hz: float = 50.0,
        speed: str = "normal",
        warn: Callable[[str], None] = lambda _: None,
    ) -> None:
        arm.model.speed(speed)
        self._session, self._arm, self._rate_hz, self._say = session, arm, rate_hz, warn
        self._name = NodeName(
            domain, str(session.info.zid()), namespace, f"ikservo_{arm.model.name}"
        )
        self._messages = ArmMessages(arm.model, arm.chain)
        self._closing, self._stack = threading.Event(), ExitStack()
        self._driver = GoalDriver(arm, speed, self._warn)
        self._publishers: dict[Topic, Callable[[RosMessage], None]] = {}
        self._warning = ""
        self._joints: tuple[JointState, ...] = ()  # last measured

    def __enter__(self) -> RosBridge:
        """Join the graph."""
        with ExitStack() as stack:
            node = RosNode(self._session, self._name, stack, self._warn, self._requested)
            self._publishers = {topic: node.publisher(topic).publish for topic in OUTPUTS}
            urdf = description_text(self._arm.model)
            self._publish(self._messages.description(time.time_ns(), urdf))
            takers = (self._take_trajectory, self._take_twist, self._take_pose)
            for topic, take in zip(INPUTS, takers, strict=True):
                node.subscribe(topic, take)
            actions = (self._stop, self._hold, self._acknowledge)
            for name, action in zip(SERVICES, actions, strict=True):
                node.serve_trigger(name, action, always=action == self._stop)
            TrajectoryAction(node, self._arm, self._driver, self._parse_trajectory)
            for run in (self._publish_states, self._watch_router):
                thread = threading.Thread(
                    target=run, name=f"ikservo-ros-{run.__name__}", daemon=True
                )
                thread.start()
                stack.callback(thread.join, _BRAKE_TIMEOUT_S)
            stack.callback(self._closing.set)
            stack.callback(self._driver.close)  # the driver closes first
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the graph; a running motion is braked, and the arm holds."""
        self._stack.close()

    # incoming messages

    def _requested(self) -> AbstractContextManager[None]:
        """Return the context of a message that arrives now; a stop from now on ends its motion."""
        background = self._arm.background
        return background.requested(background.stop_count)

    def _take_trajectory(self, message: Any) -> None:  # noqa: ANN401  # a generated class
        check_age(message.header.stamp, time.time())
        if not message.points:  # stops the arm, as in ROS 2 controllers
            self._driver.put(None)
            return
        self._move(self._parse_trajectory(message))

    def _parse_trajectory(self, message: Any) -> TrajectoryGoal:  # noqa: ANN401
        """Parse the goal in a trajectory that could begin now.

        Raises:
            InputError: The trajectory cannot be used; the message says why.
            RefusedError: A point is beyond a limit, or the arm is stopped.
        """
        self._check_not_stopped()
        lower, upper = self._arm.limits()
        names = self._arm.joint_names
        limits = dict(zip(names, zip(lower.tolist(), upper.tolist(), strict=True), strict=True))
        present = self._arm.where().positions
        return trajectory_goal(message, present, limits, time.monotonic())

    def _take_twist(self, message: Any) -> None:  # noqa: ANN401
        check_age(message.header.stamp, time.time())
        of_tool = self._is_of_tool(message.header.frame_id)
        now_s, goal = time.monotonic(), self._driver.goal
        is_new = not isinstance(goal, TwistGoal)
        if not isinstance(goal, TwistGoal):
            state, index = self._arm.where(), self._arm.joint_index
            goals = [joint.goal_rad for joint in state.joints]
            known = state.positions_rad if None in goals else np.array(goals, dtype=np.float64)
            goal = TwistGoal(self._arm.chain.forward(index.chain_joints(known)), now_s)
        linear, angular = (
            np.array([vector.x, vector.y, vector.z])
            for vector in (message.twist.linear, message.twist.angular)
        )
        goal.update(linear, angular, of_tool=of_tool, now_s=now_s)
        if is_new:
            self._move(goal)

    def _take_pose(self, message: Any) -> None:  # noqa: ANN401
        check_age(message.header.stamp, time.time())
        if self._is_of_tool(message.header.frame_id):
            raise BadValueError("The frame", self._arm.chain.tip, self._arm.chain.base)
        self._move(pose_goal(message.pose))

    def _is_of_tool(self, frame: str) -> bool:
        """Check whether a frame is the tool frame or the base frame."""
        chain = self._arm.chain
        if frame not in ("", chain.base, chain.tip):
            raise BadValueError("The frame", shown(frame), f"{chain.base} or {chain.tip}")
        return frame == chain.tip

    def _move(self, goal: MotionGoal) -> None:
        self._check_not_stopped()
        self._driver.put(goal)

    def _check_not_stopped(self) -> None:
        reason = self._arm.stop_reason
        if reason is not None or self._arm.stop_requests:
            text = "A stop was requested." if reason is None else reason.text
            raise RefusedError(f"The arm is stopped: {text} Call /acknowledge first.")

    def _stop(self) -> str:
        self._request_stop("Stopped from ROS 2.")
        torque = f"; {describe_torque(self._joints)}" if self._joints else ""
        return f"Motions end, and new ones are refused until /acknowledge is called{torque}."

    def _hold(self) -> str:
        self._driver.put(None)
        self._driver.wait_until_still(_BRAKE_TIMEOUT_S)
        self._arm.hold()
        return "The arm holds its position."

    def _acknowledge(self) -> str:
        self._arm.acknowledge()
        self._warning = ""
        return "The arm may move again."

    def _request_stop(self, text: str) -> None:
        # The stop ends the motion; if the goal also ended here, the motion might miss the stop.
        self._arm.request_stop(StopReason(StopKind.CLIENT, text))

    def _watch_router(self) -> None:
        """Stop a motion if the router is lost, because nobody could stop it then."""
        while not self._closing.wait(_ROUTER_PERIOD_S):
            if not self._driver.is_moving:
                continue
            try:
                has_router = bool(self._session.info.routers_zid())
            except Exception:  # raised if the session is closed
                has_router = False
            if not has_router:
                text = "The connection to the Zenoh router was lost; the arm holds its position."
                self._request_stop(text)
                self._warn(text)

    def _warn(self, text: str) -> None:
        self._warning = text
        self._say(text)

    # published messages

    def _publish(self, message: RosMessage) -> None:
        self._publishers[message.topic](message)

    def _publish_states(self) -> None:
        due_s, health_s = time.monotonic(), 0.0
        while not self._closing.is_set():
            now_s, state = time.monotonic(), self._measure()
            with suppress(Exception):  # raised while the session is being closed
                if state is not None:
                    now_ns, positions, self._joints = time.time_ns(), state.positions, state.joints
                    self._publish(self._messages.joint_states(now_ns, positions))
                    self._publish(self._messages.transforms(now_ns, positions))
                if now_s >= health_s:
                    health_s = now_s + _DIAGNOSTICS_PERIOD_S
                    joints = () if state is None else state.joints
                    reason = self._arm.stop_reason
                    stopped_for = "" if reason is None else reason.text
                    self._publish(
                        self._messages.diagnostics(
                            time.time_ns(), joints, stopped_for, self._warning
                        )
                    )
            due_s = max(due_s + 1.0 / self._rate_hz, time.monotonic())
            self._closing.wait(due_s - time.monotonic())

    def _measure(self) -> ArmState | None:
        try:
            return self._arm.where()
        except IkservoError as error:  # a servo that does not answer
            self._warning = error.message
        except Exception as error:  # this thread must not end
            self._warning = f"The arm cannot be read: {type(error).__name__}: {error}"
        return None
