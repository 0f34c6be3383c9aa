"""Place an arm's base by a description in words: ``base = "rotate 90, raise 0.05"``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ikservo.errors import BadValueError
from ikservo.kinematics.arrays import Matrix
from ikservo.kinematics.se3 import exp_so3, make_pose, rotation_rpy
from ikservo.model.urdf_types import Shape, Urdf, UrdfJoint, UrdfLink

_BASE_WORDS: Mapping[str, tuple[float, float, float]] = {
    "forward": (1.0, 0.0, 0.0),
    "left": (0.0, 1.0, 0.0),
    "raise": (0.0, 0.0, 1.0),
}

_MOST = 1000.0  # degrees or metres


def parse_frame(text: str) -> Matrix:
    """Parse the pose (4, 4) that words like ``rotate 90, raise 0.05`` describe.

    ``rotate`` turns to the left [deg], ``forward``, ``left`` and ``raise`` shift [m], and ``upside
    down`` turns the arm over. The steps are applied in order, along the axes of the table.

    Raises:
        BadValueError: The text does not have this form.
    """
    T = np.eye(4)
    for part in text.split(","):
        word, _, amount = part.strip().partition(" ")
        if (word, amount.strip()) == ("upside", "down"):
            T = make_pose(np.zeros(3), exp_so3([math.pi, 0.0, 0.0])) @ T
            continue
        try:
            value = float(amount)
        except ValueError:
            value = math.nan
        if not abs(value) <= _MOST or word not in ("rotate", *_BASE_WORDS):
            expected = 'such as "rotate 90, raise 0.05", with forward, left or upside down'
            raise BadValueError("The base frame", text, expected)
        if word == "rotate":
            T = make_pose(np.zeros(3), exp_so3([0.0, 0.0, math.radians(value)])) @ T
        else:
            T = make_pose(value * np.array(_BASE_WORDS[word])) @ T
    return T


def turn_base(urdf: Urdf, T: Matrix) -> Urdf:
    """Move the root of a tree, with everything on it, to a pose (4, 4) in its own frame."""

    def place_link(link: UrdfLink) -> UrdfLink:
        if link.name != urdf.root:
            return link
        com = T @ make_pose(link.com_m, rotation_rpy(*link.inertia_rpy_rad))
        return replace(
            link,
            com_m=pose_origin(com),
            inertia_rpy_rad=pose_rpy(com),
            collisions=tuple(moved_shape(each, T) for each in link.collisions),
            visuals=tuple(moved_shape(each, T) for each in link.visuals),
        )

    def place_joint(joint: UrdfJoint) -> UrdfJoint:
        if joint.parent != urdf.root:
            return joint
        origin = T @ make_pose(joint.xyz_m, rotation_rpy(*joint.rpy_rad))
        return replace(joint, xyz_m=pose_origin(origin), rpy_rad=pose_rpy(origin))

    links = tuple(place_link(link) for link in urdf.links)
    joints = tuple(place_joint(joint) for joint in urdf.joints)
    return replace(urdf, links=links, joints=joints)


def moved_shape(shape: Shape, T: Matrix) -> Shape:
    """Transform a shape to a frame in which its present frame has the pose ``T`` (4, 4)."""
    T_shape = T @ make_pose(shape.xyz_m, rotation_rpy(*shape.rpy_rad))
    return replace(shape, xyz_m=pose_origin(T_shape), rpy_rad=pose_rpy(T_shape))


def pose_origin(T: Matrix) -> tuple[float, float, float]:
    """Return the translation (x, y, z) of a pose (4, 4)."""
    x, y, z = (float(value) for value in T[:3, 3])
    return x, y, z


def pose_rpy(T: Matrix) -> tuple[float, float, float]:
    """Return roll, pitch, yaw of a pose (4, 4): R = Rz(yaw) @ Ry(pitch) @ Rx(roll)."""
    level = math.hypot(T[0, 0], T[1, 0])
    pitch = math.atan2(-T[2, 0], level)
    if level < 1e-9:  # roll and yaw rotate about the same axis
        return math.atan2(-T[1, 2], T[1, 1]), pitch, 0.0
    return math.atan2(T[2, 1], T[2, 2]), pitch, math.atan2(T[1, 0], T[0, 0])
