"""Independent references: the arm files as parsed TOML, and Pinocchio for the geometry."""

import math
import tomllib
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio

CONFIGS = Path(__file__).parents[1] / "configs"
ARMS = sorted(folder.name for folder in CONFIGS.iterdir() if folder.is_dir())


@cache
def arm_file(name):
    return tomllib.loads((CONFIGS / name / "arm.toml").read_text())


@cache
def pinocchio_model(name):
    return pinocchio.buildModelFromUrdf(str(CONFIGS / name / "arm.urdf"))


def tip_from_ticks(name, ticks):
    """Return the tip (3,) [m] for the present position registers of the servos, by id."""
    return tip_from_joints(name, joints_from_ticks(name, ticks))


def joints_from_ticks(name, ticks):
    joints = {}
    for joint in arm_file(name)["joints"]:
        servo = joint["servo"]
        turns = servo["sign"] * (ticks[servo["id"]] - servo["zero_tick"]) / 4096
        joints[joint["name"]] = turns * servo.get("m_per_turn", 2 * math.pi)
    return joints


def tip_from_joints(name, joints):
    model = pinocchio_model(name)
    q = pinocchio.neutral(model)
    for joint, value in joints.items():
        q[model.joints[model.getJointId(joint)].idx_q] = value
    data = model.createData()
    pinocchio.framesForwardKinematics(model, data, q)
    tip = data.oMf[model.getFrameId(arm_file(name)["tip"])]
    return np.array(tip.translation)
