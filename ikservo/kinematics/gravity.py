"""Torques of gravity on the joints of a chain, for links with masses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ikservo.kinematics.chain import Chain
from ikservo.kinematics.joints import JointKind
from ikservo.kinematics.numbers import finite_vectors
from ikservo.kinematics.se3 import Matrix, Vector
from ikservo.kinematics.steps import Step

__all__ = ["GRAVITY_M_S2", "LinkMass", "gravity_torques"]

GRAVITY_M_S2 = 9.81


@dataclass(frozen=True, slots=True, eq=False)
class LinkMass:
    """The mass of a link [kg] and its centre (3,) in the link's frame [m]."""

    link: str
    mass_kg: float
    centre_m: Vector


def gravity_torques(chain: Chain, masses: Sequence[LinkMass], q: ArrayLike) -> Matrix:
    """Return the torque with which gravity turns each joint (n, dof), N m (N on a slide).

    Gravity acts along -z of the base. A positive torque turns the joint forward.

    Args:
        chain: The arm; links beside the way to the tip count, too.
        masses: Of the links; those that stand still may be among them.
        q: Joint vectors (n, dof), rad or m.
    """
    q = finite_vectors(q, chain.dof, "q")
    poses, torques = chain.link_poses(q), np.zeros(q.shape)
    for mass in masses:
        T_world_link = poses[mass.link]
        centre_m = T_world_link[..., :3, :3] @ mass.centre_m + T_world_link[..., :3, 3]
        for step in chain.way(mass.link):
            if step.scale:
                slope_m = _rise(step, poses[step.joint.child], centre_m)
                torques[..., step.column] -= mass.mass_kg * GRAVITY_M_S2 * step.scale * slope_m
    return torques


def _rise(step: Step, T_world_child: Matrix, centre_m: Matrix) -> Vector:
    """Return by how much a point rises (n,) per rad or m of a joint that carries it."""
    axis = T_world_child[..., :3, :3] @ step.joint.axis
    if step.joint.kind is JointKind.PRISMATIC:
        return axis[..., 2]
    arm_m = centre_m - T_world_child[..., :3, 3]
    return axis[..., 0] * arm_m[..., 1] - axis[..., 1] * arm_m[..., 0]
