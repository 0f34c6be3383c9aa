"""Forces at the tip and torques of the joints, by virtual work (lecture L11)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ikservo.kinematics.chain import Chain
from ikservo.kinematics.numbers import finite_vector
from ikservo.kinematics.se3 import Vector

__all__ = ["joint_torques"]


def joint_torques(
    chain: Chain,
    q: ArrayLike,
    force_n: ArrayLike,
    *,
    moment_nm: ArrayLike = (0.0, 0.0, 0.0),
    frame: str | None = None,
    offset_m: ArrayLike | None = None,
) -> Vector:
    """Return what a force at a point of the arm does to each joint: ``tau = Jᵀ F`` (lecture L11).

    A small motion dq of the joints moves the point by ``J dq``, and the force does the work
    ``Fᵀ J dq``; torques that do the same work, ``tauᵀ dq``, are ``tau = Jᵀ F``. So a joint is
    turned by tau where the force pulls at the arm, has to hold against it with -tau, and where the
    arm shall press on something with F, with tau. The weight of the arm itself is not in it.

    Args:
        chain: The arm.
        q: The posture (dof,), rad or m.
        force_n: The force (3,), newtons, base frame; a mass m that hangs there pulls with
            (0, 0, -9.81 m).
        moment_nm: A moment (3,) on the link besides, newton metres, base frame.
        frame: Name of the link that the force pulls at; the tip if None.
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
