"""Small chains that tests define by hand."""

import math

import numpy as np

from ikservo.kinematics import Chain, Joint, JointType, Mimic
from ikservo.kinematics.se3 import make_pose

Z = np.array([0.0, 0.0, 1.0])


def joint(name, kind, parent, child, xyz=(0, 0, 0), axis=Z, **kwargs):
    return Joint(
        name, kind, parent, child, make_pose(np.array(xyz, float)), np.array(axis), **kwargs
    )


def planar(*lengths_m, limit_rad=math.pi):
    """Return the lecture's arm: n turning joints in a plane, then the tip."""
    joints, x = [], 0.0
    for i, length in enumerate(lengths_m):
        joints.append(
            joint(f"j{i + 1}", JointType.REVOLUTE, f"l{i}", f"l{i + 1}", (x, 0, 0),
                  lower=-limit_rad, upper=limit_rad)
        )  # fmt: skip
        x = length
    joints.append(joint("end", JointType.FIXED, f"l{len(lengths_m)}", "tip", (x, 0, 0)))
    return Chain.from_joints(joints, "l0", "tip")


def crane_joints():
    return [
        joint("slide", JointType.PRISMATIC, "column", "cart", (0, 0, 0.5), (1, 0, 0),
              lower=0.0, upper=0.4),
        joint("hook", JointType.PRISMATIC, "cart", "hook", (0, 0, 0), (0, 0, -1),
              mimic=Mimic("slide", 0.5, 0.1)),
        joint("turn", JointType.REVOLUTE, "base", "column", lower=-2.0, upper=2.0),
        joint("brake", JointType.REVOLUTE, "column", "lever", lower=0.2, upper=0.9),
    ]  # fmt: skip


def crane():
    """Return a turning column, a slide along x and a hook that mimics the slide downwards."""
    return Chain.from_joints(crane_joints(), "base", "hook")
