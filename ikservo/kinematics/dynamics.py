"""Joint torques of gravity, and of a force at the tip by virtual work."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ikservo.kinematics.arrays import Matrix, Vector, finite_vector, finite_vectors
from ikservo.kinematics.chain import Chain
from ikservo.kinematics.joints import ChainJoint, JointType

__all__ = ["GRAVITY_M_S2", "LinkMass", "gravity_torques", "joint_torques"]


def joint_torques(
    chain: Chain,
    q: ArrayLike,
    force_n: ArrayLike,
    *,
    moment_nm: ArrayLike = (0.0, 0.0, 0.0),
    frame: str | None = None,
    offset_m: ArrayLike | None = None,
) -> Vector:
    """Return the joint torques of a force at a point of the arm: ``tau = Jᵀ F``.

    A small motion dq of the joints moves the point by ``J dq``, and the force does the work
    ``Fᵀ J dq``; torques that do the same work, ``tauᵀ dq``, are ``tau = Jᵀ F``. A force that pulls
    at the arm acts on a joint with tau, and the joint holds it with -tau; to press on something
    with F, it needs tau. The weight of the arm itself is not included.

    Args:
        chain: The arm.
        q: The posture (dof,), rad or m.
        force_n: The force (3,), newtons, base frame; a suspended mass m pulls with
            (0, 0, -9.81 m).
        moment_nm: An additional moment (3,) on the link, newton metres, base frame.
        frame: Name of the link that the force acts on; the tip if None.
        offset_m: The point (3,) in that link's coordinates, metres; its origin if None.

    Returns:
        tau (dof,): newton metres, newtons for a prismatic joint; positive towards larger q.

    Raises:
        BadValueError: A shape is wrong or a number is not finite.
        UnknownNameError: No link is named ``frame``.
    """
    wrench = np.concatenate(
        [finite_vector(force_n, 3, "The force"), finite_vector(moment_nm, 3, "The moment")]
    )
    J = chain.jacobian(finite_vector(q, chain.dof, "q"), frame, offset_m)
    tau: Vector = J.T @ wrench
    return tau


GRAVITY_M_S2 = 9.81


@dataclass(frozen=True, slots=True, eq=False)
class LinkMass:
    """The mass of a link [kg] and its centre (3,) in the link's frame [m]."""

    link: str
    mass_kg: float
    centre_m: Vector


def gravity_torques(chain: Chain, masses: Sequence[LinkMass], q: ArrayLike) -> Matrix:
    """Return the torque of gravity on each joint (n, dof), N m (N on a prismatic joint).

    Gravity acts along -z of the base. A positive torque acts towards larger q.

    Args:
        chain: The arm; links beside the path to the tip count, too.
        masses: Of the links; fixed ones may be among them.
        q: Joint vectors (n, dof), rad or m.
    """
    q = finite_vectors(q, chain.dof, "q")
    poses, torques = chain.link_poses(q), np.zeros(q.shape)
    for mass in masses:
        T_world_link = poses[mass.link]
        centre_m = T_world_link[..., :3, :3] @ mass.centre_m + T_world_link[..., :3, 3]
        for step in chain.joints_to(mass.link):
            if step.scale:
                slope_m = _height_derivative(step, poses[step.joint.child], centre_m)
                torques[..., step.column] -= mass.mass_kg * GRAVITY_M_S2 * step.scale * slope_m
    return torques


def _height_derivative(step: ChainJoint, T_world_child: Matrix, centre_m: Matrix) -> Vector:
    """Return the height change of a point (n,) per rad or m of a joint that moves it."""
    axis = T_world_child[..., :3, :3] @ step.joint.axis
    if step.joint.kind is JointType.PRISMATIC:
        return axis[..., 2]
    arm_m = centre_m - T_world_child[..., :3, 3]
    return axis[..., 0] * arm_m[..., 1] - axis[..., 1] * arm_m[..., 0]
