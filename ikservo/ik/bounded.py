"""The production solver: damped least squares inside the joint limits (lecture L9, L13).

Minimises ``|E(q)|²`` with Levenberg-Marquardt steps in which joints at a limit that would leave
it are held there by an active set, so that no iterate is ever outside the limits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ikservo.ik.target import Target
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["Descent", "descend"]

_MAX_ITERATIONS = 100
_DAMPING_START, _DAMPING_MIN, _DAMPING_MAX = 1e-4, 1e-12, 1e8
# The linear model is good for about this far (lecture L7 goes 2° at a time, without a check of
# the error after the step); it also keeps the search on the branch it started on.
_TRUST_RAD = 0.3
# A step or gradient this small moves the tool by less than a nanometre.
_STEP_END, _GRADIENT_END = 1e-11, 1e-13


@dataclass(frozen=True, slots=True, eq=False)
class Descent:
    """Where one descent ended.

    Attributes:
        q: Joint vector (dof,), inside the limits.
        gradient: Of ``|E|²/2`` at q (dof,); a joint pressed against its limit has a part of it
            that points outwards.
        iterations: Steps tried.
    """

    q: Vector
    gradient: Vector
    iterations: int


def descend(chain: Chain, target: Target, q0: Vector, turn_weight_m_rad: float) -> Descent:
    """Walk downhill from ``q0`` to a local minimum of the weighted error.

    Args:
        chain: The arm.
        target: What is wanted.
        q0: Start (dof,), inside the limits.
        turn_weight_m_rad: How many metres of position error one radian of orientation error is
            worth; 0 ignores the orientation.
    """
    q, damping = q0, _DAMPING_START
    error, J = _linearise(chain, target, q, turn_weight_m_rad)
    for iteration in range(_MAX_ITERATIONS):
        gradient = -J.T @ error
        if _projected(gradient, q, chain) < _GRADIENT_END:
            return Descent(q, gradient, iteration)
        low = np.maximum(chain.lower_rad - q, -_TRUST_RAD)
        high = np.minimum(chain.upper_rad - q, _TRUST_RAD)
        step = _bounded_step(J, error, damping, low, high)
        if float(np.abs(step).max()) < _STEP_END:
            return Descent(q, gradient, iteration)
        tried = chain.clip(q + step)
        tried_error, tried_J = _linearise(chain, target, tried, turn_weight_m_rad)
        if tried_error @ tried_error < error @ error:
            q, error, J = tried, tried_error, tried_J
            damping = max(damping * 0.1, _DAMPING_MIN)
        elif damping < _DAMPING_MAX:
            damping *= 10.0
        else:
            return Descent(q, gradient, iteration)
    return Descent(q, -J.T @ error, _MAX_ITERATIONS)


def _linearise(chain: Chain, target: Target, q: Vector, weight: float) -> tuple[Vector, Matrix]:
    """Return the error E = M - f(q) and its Jacobian, orientation rows weighted."""
    T = chain.forward(q, target.frame, target.offset_m)
    J = chain.jacobian(q, target.frame, target.offset_m)
    position_error = target.position - T[:3, 3]
    if weight == 0.0 or target.only_position:
        return position_error, J[:3]
    turn_error = weight * target.turn_left(T[:3, :3])
    return np.concatenate([position_error, turn_error]), _turn_rows(J, T, target, weight)


def _turn_rows(J: Matrix, T: Matrix, target: Target, weight: float) -> Matrix:
    """Weight the angular rows; a wanted direction does not care for turns about itself."""
    angular = J[3:]
    if target.rotation is None:
        axis = T[:3, :3] @ target.axis
        angular = angular - np.outer(axis, axis @ angular)
    return np.vstack([J[:3], weight * angular])


def _bounded_step(J: Matrix, error: Vector, damping: float, low: Vector, high: Vector) -> Vector:
    """Return the damped least-squares step inside ``low <= step <= high`` (lecture L9).

    Joints that would leave their range are set on its end one round after another, and the
    others are solved again for what is left.
    """
    step = np.zeros(J.shape[1])
    free = np.ones(J.shape[1], dtype=bool)
    while free.any():
        rest = error - J[:, ~free] @ step[~free]
        step[free] = _damped(J[:, free], rest, damping)
        outside = free & ((step < low) | (step > high))
        if not outside.any():
            break
        step[outside] = np.clip(step[outside], low[outside], high[outside])
        free &= ~outside
    return step


def _damped(J: Matrix, error: Vector, damping: float) -> Vector:
    """Solve (JᵀJ + λ) Δ = Jᵀ E with λ relative to the size of J."""
    A = J.T @ J
    A[np.diag_indices_from(A)] += damping * max(float(np.trace(A)), 1e-12)
    return np.linalg.solve(A, J.T @ error).astype(np.float64)


def _projected(gradient: Vector, q: Vector, chain: Chain) -> float:
    """Return the largest part of the gradient that a step inside the limits could follow."""
    held = ((q <= chain.lower_rad) & (gradient > 0)) | ((q >= chain.upper_rad) & (gradient < 0))
    return float(np.abs(np.where(held, 0.0, gradient)).max())
