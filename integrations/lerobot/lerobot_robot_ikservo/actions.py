"""Kinds of actions: joint positions, a pose of the tip, or a step of the tip."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ikservo import Model, OpenArm
from ikservo.apps.teaching.lerobot_values import JointValues
from ikservo.kinematics.se3 import exp_so3, log_so3, make_pose
from lerobot_robot_ikservo.config import IkservoRobotConfig
from lerobot_robot_ikservo.kinematics import TipSolver

__all__ = ["POSE_KEYS", "ActionKind", "JointActions", "StepActions", "action_kind", "pose_values"]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_POSITION_KEYS = ("ee.x", "ee.y", "ee.z")
_TURN_KEYS = ("ee.wx", "ee.wy", "ee.wz")
POSE_KEYS = (*_POSITION_KEYS, *_TURN_KEYS)
"""Keys of the tip pose in the base frame: position in metres, rotation vector in radians."""

_GRIPPER_KEY = "ee.gripper_pos"
_STEP_KEYS = ("delta_x", "delta_y", "delta_z")
_STEP_GRIPPER_KEY = "gripper"
_CLOSE, _OPEN = 0.0, 2.0  # from LeRobot's teleoperators; 1 means stay, as does -1
_UNREACHED_M = 0.002  # a smaller error of a goal is not reported


class ActionKind(Protocol):
    """A kind of action."""

    @property
    def features(self) -> dict[str, type]:
        """Return LeRobot's description of the action values."""
        ...

    def goal(self, action: Mapping[str, Any], last: Vector, arm: OpenArm) -> tuple[Vector, str]:
        """Return the goal (n,) of an action, given the ``last`` goal, and a text on its error.

        Raises:
            KeyError: The action lacks a value.
        """
        ...


def action_kind(config: IkservoRobotConfig, model: Model, values: JointValues) -> ActionKind:
    """Return the kind of action that a configuration selects."""
    if config.action == "joint":
        return JointActions(values)
    gripper = None if model.gripper is None else model.gripper.joint
    if config.action == "ee":
        return PoseActions(values, gripper)
    return StepActions(values, gripper, config.step_m, config.gripper_step)


def pose_values(T_base_tip: Matrix) -> dict[str, float]:
    """Return a pose (4, 4) with LeRobot's keys."""
    numbers = [*T_base_tip[:3, 3].tolist(), *log_so3(T_base_tip[:3, :3]).tolist()]
    return dict(zip(POSE_KEYS, numbers, strict=True))


class JointActions:
    """Actions with joint positions, ``<joint>.pos``."""

    def __init__(self, values: JointValues) -> None:
        self._values = values

    @property
    def features(self) -> dict[str, type]:
        """Return one value per joint."""
        return self._values.features

    def goal(self, action: Mapping[str, Any], last: Vector, arm: OpenArm) -> tuple[Vector, str]:
        """Return the positions; joints without a value keep their last position."""
        del arm  # keys of the other kinds
        return self._values.to_positions(action, last), ""


class PoseActions:
    """Actions with a pose of the tip, ``ee.x`` to ``ee.wz``, and the gripper in percent."""

    def __init__(self, values: JointValues, gripper: str | None) -> None:
        self._values, self._gripper = values, gripper
        self._solver: TipSolver | None = None

    @property
    def features(self) -> dict[str, type]:
        """Return the pose, and the gripper if there is one."""
        keys = POSE_KEYS if self._gripper is None else (*POSE_KEYS, _GRIPPER_KEY)
        return dict.fromkeys(keys, float)

    def goal(self, action: Mapping[str, Any], last: Vector, arm: OpenArm) -> tuple[Vector, str]:
        """Return the joints that put the tip into the pose, close to the last joints."""
        position = [float(action[key]) for key in _POSITION_KEYS]
        T = make_pose(position, exp_so3([float(action[key]) for key in _TURN_KEYS]))
        goal, missing = self.joints_at(T, last, arm)
        if self._gripper is not None and _GRIPPER_KEY in action:
            percent = {f"{self._gripper}.pos": action[_GRIPPER_KEY]}
            goal = self._values.to_positions(percent, goal)
        return goal, missing

    def joints_at(self, T_base_tip: Matrix, last: Vector, arm: OpenArm) -> tuple[Vector, str]:
        """Return all joints (n,) for a pose of the tip, and a text on what cannot be reached."""
        if self._solver is None or self._solver.chain is not arm.chain:
            self._solver = TipSolver(arm.chain)
        index = arm.joint_index
        q, error_m = self._solver.solve(T_base_tip, index.chain_joints(last))
        missing = "" if error_m <= _UNREACHED_M else _unreached_text(T_base_tip, error_m)
        return index.with_chain(last, q), missing


class StepActions:
    """Actions with steps of the tip and gripper, as ``keyboard_ee`` and ``gamepad`` send them."""

    def __init__(
        self, values: JointValues, gripper: str | None, step_m: float, gripper_step: float
    ) -> None:
        self._values, self._gripper = values, gripper
        self._step_m, self._gripper_step = step_m, gripper_step
        self._poses = PoseActions(values, gripper)

    @property
    def features(self) -> dict[str, type]:
        """Return the steps, including that of the gripper if there is one."""
        keys = _STEP_KEYS if self._gripper is None else (*_STEP_KEYS, _STEP_GRIPPER_KEY)
        return dict.fromkeys(keys, float)

    def goal(self, action: Mapping[str, Any], last: Vector, arm: OpenArm) -> tuple[Vector, str]:
        """Return the joints after a step; the tool keeps its orientation as well as possible."""
        step_m = self._step_m * np.array([float(action[key]) for key in _STEP_KEYS])
        goal, missing = last, ""
        if step_m.any():
            T = arm.chain.forward(arm.joint_index.chain_joints(last)).copy()
            T[:3, 3] += step_m
            goal, missing = self._poses.joints_at(T, last, arm)
        return self._with_gripper(action, goal), missing

    def _with_gripper(self, action: Mapping[str, Any], goal: Vector) -> Vector:
        way = {_CLOSE: -1.0, _OPEN: 1.0}.get(float(action.get(_STEP_GRIPPER_KEY, 1.0)), 0.0)
        if self._gripper is None or not way:
            return goal
        key = f"{self._gripper}.pos"
        percent = self._values.from_positions(goal)[key] + way * self._gripper_step
        return self._values.to_positions({key: min(100.0, max(0.0, percent))}, goal)


def _unreached_text(T_base_tip: Matrix, error_m: float) -> str:
    point = ", ".join(f"{x:.3f}" for x in T_base_tip[:3, 3])
    return (
        f"({point}) m is out of reach by {error_m * 1000:.0f} mm; the tip moves as close to it "
        f"as it can."
    )
