"""Test LeRobot's end-effector processors with ikservo's kinematics instead of placo."""

import builtins

import numpy as np
import pytest
from lerobot.processor import RobotProcessorPipeline
from lerobot.processor.converters import (
    robot_action_observation_to_transition,
    transition_to_robot_action,
)
from lerobot.robots.so_follower.robot_kinematic_processor import (
    EEBoundsAndSafety,
    EEReferenceAndDelta,
    GripperVelocityToJoint,
    InverseKinematicsEEToJoints,
)

import ikservo
from lerobot_robot_ikservo import IkservoKinematics

NAMES = [joint.name for joint in ikservo.load_model("so101").joints]


@pytest.fixture
def pipeline():
    kinematics = IkservoKinematics("so101", joint_names=NAMES)
    steps = [
        EEReferenceAndDelta(
            kinematics=kinematics,
            end_effector_step_sizes={"x": 1.0, "y": 1.0, "z": 1.0},
            motor_names=NAMES,
            use_latched_reference=True,
        ),
        EEBoundsAndSafety(end_effector_bounds={"min": [-1.0] * 3, "max": [1.0] * 3}),
        GripperVelocityToJoint(),
        InverseKinematicsEEToJoints(
            kinematics=kinematics, motor_names=NAMES, initial_guess_current_joints=False
        ),
    ]
    return kinematics, RobotProcessorPipeline(
        steps=steps,
        to_transition=robot_action_observation_to_transition,
        to_output=transition_to_robot_action,
    )


def test_lerobot_processors_reach_target_without_placo(pipeline, monkeypatch):
    imported = builtins.__import__

    def without_placo(name, *args, **kwargs):
        assert name != "placo"
        return imported(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without_placo)
    kinematics, process = pipeline
    home = np.degrees([*ikservo.load_model("so101").chain_pose("home"), 0.0])
    home[-1] = 30.0
    observation = dict(zip([f"{name}.pos" for name in NAMES], home, strict=True))
    start = kinematics.forward_kinematics(home)[:3, 3]
    for step in range(20):
        targets = dict.fromkeys(
            ["target_x", "target_z", "target_wx", "target_wy", "target_wz"], 0.0
        )
        action = {"enabled": True, **targets, "target_y": 0.002 * step, "gripper_vel": 0.0}
        sent = process((action, observation))
    q = [sent[f"{name}.pos"] for name in NAMES]
    moved = kinematics.forward_kinematics(q)[:3, 3] - start
    np.testing.assert_allclose(moved, [0.0, 0.038, 0.0], atol=5e-4)
    assert sent["gripper.pos"] == pytest.approx(30.0)
