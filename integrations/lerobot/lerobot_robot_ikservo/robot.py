"""``--robot.type=ikservo``: any ikservo arm as a LeRobot robot."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.motors import Motor, MotorNormMode
from lerobot.robots import Robot
from lerobot.utils.errors import DeviceNotConnectedError
from numpy.typing import NDArray

import ikservo
from ikservo.arm import check_followed_goal
from lerobot_robot_ikservo.actions import (
    POSE_KEYS,
    ActionKind,
    JointActions,
    StepActions,
    action_kind,
    pose_values,
)
from lerobot_robot_ikservo.arm_connection import ArmConnection
from lerobot_robot_ikservo.arm_motion import ArmMotion
from lerobot_robot_ikservo.config import IkservoRobotConfig

__all__ = ["IkservoRobot"]

Vector = NDArray[np.float64]

_LOG = logging.getLogger(__name__)
_MAX_LEAD_M = 0.05  # steps are not added while the arm is further behind


class JointBus:
    """The data that LeRobot's programs read from ``robot.bus``: names, ids and models of servos.

    Attributes:
        motors: LeRobot's description of each joint's drive, in the order of the observation.
    """

    def __init__(self, model: ikservo.Model) -> None:
        gripper = None if model.gripper is None else model.gripper.joint
        self.motors = {
            joint.name: Motor(joint.servo.id, joint.servo.model, _norm_mode(joint.name == gripper))
            for joint in model.joints
        }


def _norm_mode(is_gripper: bool) -> MotorNormMode:
    return MotorNormMode.RANGE_0_100 if is_gripper else MotorNormMode.DEGREES


class IkservoRobot(Robot):
    """An ikservo arm. Every action passes its guard, and the arm holds when LeRobot ends.

    Args:
        config: See ``IkservoRobotConfig``.

    Attributes:
        bus: The servos by joint.
        cameras: LeRobot's cameras by name.

    Raises:
        UnknownNameError: There is no such arm.
    """

    config_class = IkservoRobotConfig
    name = "ikservo"

    def __init__(self, config: IkservoRobotConfig) -> None:
        super().__init__(config)
        self.config = config
        self.cameras = make_cameras_from_configs(config.cameras)
        on_exit = "relax" if config.on_exit == "relax" else "hold"
        self._connection = ArmConnection(config, str(self), on_exit)
        self._values = self._connection.values
        self._joint_actions = JointActions(self._values)
        self._actions = action_kind(config, self._connection.model, self._values)
        self.bus = JointBus(self._connection.model)
        self._motion: ArmMotion | None = None
        self._goal: Vector | None = None

    @property
    def observation_features(self) -> dict[str, Any]:
        """Return joints, pictures and, if requested, the pose of the tip."""
        pictures = {name: (camera.height, camera.width, 3) for name, camera in self.cameras.items()}
        pose = dict.fromkeys(POSE_KEYS, float) if self.config.observe_tip else {}
        return {**self._values.features, **pose, **pictures}

    @property
    def action_features(self) -> dict[str, type]:
        """Return the values of an action."""
        return self._actions.features

    @property
    def is_connected(self) -> bool:
        """Return whether the arm is open."""
        return self._connection.is_open

    @property
    def is_calibrated(self) -> bool:
        """Return whether the zeros of the arm's joints are known."""
        return self._connection.arm.zeros.are_known

    def connect(self, calibrate: bool = True) -> None:
        """Open the arm; nothing moves and no torque changes.

        Raises:
            DeviceAlreadyConnectedError: The arm is already open.
            IkservoError: The arm cannot be opened; the message says what to do.
        """
        self._connection.open()
        self._begin_motion()
        if calibrate and not self.is_calibrated:
            self.calibrate()
        for camera in self.cameras.values():
            camera.connect()
        self.configure()

    def calibrate(self) -> None:
        """Run ``ikservo calibrate``, or ``ikservo import lerobot``, and write LeRobot's file."""
        self._end_motion()
        has_file = self._connection.calibrate(self.calibration_fpath)
        self._begin_motion()
        if has_file:
            self._load_calibration()

    def configure(self) -> None:
        """Do nothing, because ikservo configures the servos when it calibrates them."""

    def get_observation(self) -> dict[str, Any]:
        """Measure and return the values of ``observation_features``."""
        joints = self._require_motion().measure()
        pose = self._tip_values(joints) if self.config.observe_tip else {}
        pictures = {name: camera.async_read() for name, camera in self.cameras.items()}
        return {**self._values.from_positions(joints), **pose, **pictures}

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Send a goal; log it if it is refused or out of reach.

        After a refusal, the previous goal stays in force. If a goal is out of reach, the arm moves
        as close to it as it can. Joint positions are accepted in every mode, because LeRobot's
        programs use them to return to the start.

        Returns:
            The action; joint positions inside the arm's limits.

        Raises:
            ValueError: The keys are neither those of ``action_features`` nor joints.
        """
        arm, motion = self._connection.arm, self._require_motion()
        last = motion.setpoint() if self._goal is None else self._goal
        kind = self._kind_of(action)
        try:
            goal, missing = kind.goal(action, last, arm)
        except KeyError as error:
            raise ValueError(self._wrong_action_text(error.args[0])) from error
        if not np.isfinite(goal).all():
            motion.report("The action has values that are not numbers; the arm holds.")
            return action
        inside = np.clip(goal, *arm.limits())
        is_step = isinstance(kind, StepActions) and not np.array_equal(last, inside)
        refusal = self._step_refusal(inside) if is_step else ""
        motion.report(refusal or missing or self._outside_text(arm, goal, inside))
        if refusal or (is_step and self._leads_too_far(last, inside)):
            inside = last
        self._goal = motion.send(inside)
        return self._values.from_positions(inside) if isinstance(kind, JointActions) else action

    def _kind_of(self, action: dict[str, Any]) -> ActionKind:
        """Return the chosen kind, or joint actions for an action that has only joints."""
        has_own = not self._actions.features.keys().isdisjoint(action)
        has_joints = not self._values.features.keys().isdisjoint(action)
        return self._joint_actions if has_joints and not has_own else self._actions

    def disconnect(self) -> None:
        """Brake, hold and close the arm; torque stays on unless ``on_exit`` is ``relax``."""
        self._require_motion()
        for camera in self.cameras.values():
            camera.disconnect()
        self._end_motion()
        self._connection.close()

    def _begin_motion(self) -> None:
        self._motion = ArmMotion(self._connection.arm, self.config.speed)
        self._goal = None

    def _end_motion(self) -> None:
        self._require_motion().close()
        self._motion = None

    def _step_refusal(self, goal: Vector) -> str:
        """Return the reason why the guard refuses a step; the next step keeps the same start."""
        arm = self._connection.arm
        if not isinstance(arm, ikservo.Arm):
            return ""
        start = self._require_motion().setpoint()
        try:
            check_followed_goal(arm.context, start, goal, self.config.speed)
        except ikservo.RefusedError as error:
            return error.message
        return ""

    def _leads_too_far(self, last: Vector, goal: Vector) -> bool:
        """Return whether a step would move the goal too far ahead of an arm that cannot follow."""
        arm, setpoint = self._connection.arm, self._require_motion().setpoint()
        now, before, after = (
            arm.chain.forward(arm.joint_index.chain_joints(q))[:3, 3]
            for q in (setpoint, last, goal)
        )
        lead_m = float(np.linalg.norm(after - now))
        return lead_m > max(_MAX_LEAD_M, float(np.linalg.norm(before - now)))

    def _tip_values(self, joints: Vector) -> dict[str, float]:
        arm = self._connection.arm
        return pose_values(arm.chain.forward(arm.joint_index.chain_joints(joints)))

    def _outside_text(self, arm: ikservo.OpenArm, goal: Vector, inside: Vector) -> str:
        beyond = np.flatnonzero(np.abs(goal - inside) > np.radians(0.5))
        names = ", ".join(arm.joint_names[i] for i in beyond)
        return f"Limited to this arm's range: {names}." if names else ""

    def _wrong_action_text(self, key: str) -> str:
        return (
            f"The action has no {key!r}; --robot.action={self.config.action} takes "
            f"{', '.join(self.action_features)}. For keyboard_ee and gamepad: "
            "--robot.action=ee_delta; for leader arms and ikservo_page: --robot.action=joint."
        )

    def _require_motion(self) -> ArmMotion:
        if self._motion is None:
            raise DeviceNotConnectedError(f"{self} is not connected.")
        return self._motion
