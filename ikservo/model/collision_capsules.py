"""Build the collision capsules of an arm with its gripper."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from ikservo.errors import InputError
from ikservo.kinematics.arrays import Vector
from ikservo.kinematics.capsules import Capsule, segment_distance
from ikservo.kinematics.collision_body import CollisionBody
from ikservo.kinematics.se3 import rotation_rpy
from ikservo.model.arm_model import Model
from ikservo.model.model_loading import build_chain
from ikservo.model.urdf_types import Box, Cylinder, Mesh, Shape, Sphere, Surface
from ikservo.model.urdf_xml import import_command


def collision_body(model: Model) -> CollisionBody:
    """Return the arm's collision body; overlaps of pairs in its named poses are allowed."""
    postures = [model.chain_pose(name) for name in model.poses]
    return CollisionBody(model.chain, _require_capsules(model), postures)


def collision_body_with_gripper(model: Model) -> CollisionBody:
    """Return the body whose joint vectors end with the gripper's joint, if the arm has one.

    In ``collision_body`` the jaws are fixed at zero, or as near to it as their range allows. Here
    they follow the vector's last joint. Jaws that the chain's last joint does not carry stay fixed.
    """
    gripper = model.gripper
    if gripper is None:
        return collision_body(model)
    jaws = [joint.child for joint in model.urdf.joints if joint.name == gripper.joint]
    chains = [build_chain(model.urdf, jaw) for jaw in jaws]
    chain = next((each for each in chains if each.names[:-1] == model.chain.names), None)
    if chain is None:
        return collision_body(model)
    poses = [np.array([pose[name] for name in chain.names]) for pose in model.poses.values()]
    closed = [np.append(q[:-1], gripper.closed) for q in poses]  # jaws may touch each other
    capsules = _require_capsules(model)
    body = CollisionBody(chain, capsules, poses + closed)
    opening: list[Vector] = []
    if "rest" in model.poses:
        # A limp arm sinks a little below its rest pose; its jaws need the clearance in that
        # position, too.
        rest = np.array([model.poses["rest"][name] for name in chain.names])
        spread = np.linspace(gripper.closed, gripper.open, _JAW_SAMPLES)
        opening = [np.append(rest[:-1], at) for at in spread]
        if not (body.link_distances(np.array(opening)).gap_m >= 0.0).all():
            opening = []
    return CollisionBody(chain, capsules, poses + closed + opening)


_JAW_SAMPLES = 16


def capsules_of(model: Model) -> list[Capsule]:
    """Return capsules around each link's collision shapes, or visual shapes if it has none.

    Raises:
        InputError: A shape is a mesh; the link is named.
    """
    found: list[Capsule] = []
    for link in model.urdf.links:
        shapes = link.collisions or link.visuals
        own = [each for shape in shapes for each in bounding_capsules(link.name, shape)]
        found += _without_contained(own)
    return found


def _without_contained(capsules: list[Capsule]) -> list[Capsule]:
    """Remove capsules inside another capsule, such as the spheres at the ends of a cylinder.

    Capsules are convex, so one contains another if it contains both ends of the other.
    """
    if len(capsules) < 2:
        return capsules
    ordered = sorted(capsules, key=lambda each: (-each.radius_m, -each.length_m))
    starts, ends = (np.array([getattr(each, end) for each in ordered])
                    for end in ("start_m", "end_m"))  # fmt: skip
    radii_m = np.array([each.radius_m for each in ordered])
    away_m = np.maximum(
        *(segment_distance(starts, ends, at[:, None], at[:, None]) for at in (starts, ends))
    )
    inside = away_m + radii_m[:, None] <= radii_m + _ROUNDING_M
    kept: list[int] = []
    for i in range(len(ordered)):
        if not inside[i, kept].any():
            kept.append(i)
    return [ordered[i] for i in kept]


_ROUNDING_M = 3e-6  # rounding of lengths in a file


def _require_capsules(model: Model) -> list[Capsule]:
    capsules = capsules_of(model)
    if not capsules:
        raise InputError(
            f"Contact cannot be checked, because no link of {model.name} has a shape.",
            "Add <collision> shapes to its description, or use --no-collision "
            "(collisions=False) if you can see that the path is free.",
        )
    return capsules


def bounding_capsules(link: str, shape: Shape) -> list[Capsule]:
    """Return capsules that cover a shape.

    A box is covered along its longest edge by parallel capsules, one through the middle of each
    strip; the number of strips is the ratio of the middle edge to the shortest one.

    Raises:
        InputError: The shape is a mesh; the link is named.
    """
    if isinstance(shape, Mesh | Surface):
        hint = f"Convert the description: {import_command(Path('FILE'))}"
        raise InputError(f"Contact cannot be checked, because link {link} has a mesh.", hint)
    if isinstance(shape, Sphere):
        centre = np.array(shape.xyz_m)
        return [Capsule(link, centre, centre, shape.radius_m)]
    if isinstance(shape, Cylinder):
        return [
            _axial_capsule(link, shape, np.array([0.0, 0.0, shape.length_m / 2]), shape.radius_m)
        ]
    half = np.array(shape.size_m) / 2
    thin, middle, long = np.argsort(half)
    strips = max(1, math.ceil(half[middle] / max(half[thin], 1e-6) - 0.25))
    strips = min(strips, _MAX_STRIPS)
    strip = half[middle] / strips
    radius_m = math.hypot(strip, half[thin])
    capsules: list[Capsule] = []
    for i in range(strips):
        aside, ahead = np.zeros(3), np.zeros(3)
        aside[middle] = (2 * i + 1) * strip - half[middle]
        ahead[long] = half[long]
        capsules.append(_axial_capsule(link, shape, ahead, radius_m, aside))
    return capsules


_MAX_STRIPS = 4


def _axial_capsule(
    link: str, shape: Box | Cylinder, half_m: Vector, radius_m: float, aside_m: Vector | None = None
) -> Capsule:
    """Return the capsule from -half to +half along a shape's local axes, in link coordinates."""
    R, centre = rotation_rpy(*shape.rpy_rad), np.array(shape.xyz_m)
    middle = centre if aside_m is None else centre + R @ aside_m
    return Capsule(link, middle - R @ half_m, middle + R @ half_m, radius_m)
