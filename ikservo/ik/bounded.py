"""The production solver: damped least squares inside the joint limits (lecture L9, L13).

Minimises ``|E(q)|²`` with damped Newton steps, which near a solution are Levenberg-Marquardt's.
Joints at a limit that would leave it are held there by an active set, so that no iterate is ever
outside the limits.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ikservo.ik.answer import answer, closer
from ikservo.ik.options import Options
from ikservo.ik.result import Result
from ikservo.ik.seeds import seeds
from ikservo.ik.target import Target
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["Descent", "bounded", "descend"]

_MAX_ITERATIONS = 100
# One radian weighs like a lever of this length, about half of a small arm.
_TURN_WEIGHT_M_RAD = 0.1
_FULL_POSE_DOF = 6
_DAMPING_START, _DAMPING_MIN, _DAMPING_MAX = 1e-4, 1e-12, 1e8
# The linear model is good for about this far (lecture L7 goes 2° at a time, without a check of
# the error after the step); it also keeps the search on the branch it started on.
_TRUST_RAD = 0.3
# A step or gradient this small moves the tool by less than a nanometre.
_STEP_END, _GRADIENT_END = 1e-11, 1e-13


def bounded(chain: Chain, target: Target, q0: Vector, options: Options) -> Result:
    """Descend from one seed after another until one reaches; else answer with the closest."""
    best: Result | None = None
    iterations = 0
    for seed in seeds(chain, q0, options.restarts):
        descent = _descend_by_priority(chain, target, seed, options)
        iterations += descent.iterations
        found = answer(
            chain,
            target,
            descent.q,
            options.tolerance,
            method="bounded",
            iterations=iterations,
            trace=descent.trace,
        )
        if best is None or closer(found, best, options.tolerance):
            best = found
        if best.reached:
            break
    assert best is not None  # noqa: S101  # Options allows no fewer than one restart
    return replace(best, iterations=iterations)


@dataclass(frozen=True, slots=True, eq=False)
class Descent:
    """Where one descent ended.

    Attributes:
        q: Joint vector (dof,), inside the limits.
        iterations: Steps tried.
        trace: Every iterate, the start first, where it was asked for.
    """

    q: Vector
    iterations: int
    trace: tuple[Vector, ...] = ()


def descend(
    chain: Chain, target: Target, q0: Vector, turn_weight_m_rad: float, options: Options
) -> Descent:
    """Walk downhill from ``q0`` to a local minimum of the weighted error.

    Args:
        chain: The arm.
        target: What is wanted.
        q0: Start (dof,), inside the limits.
        turn_weight_m_rad: How many metres of position error one radian of orientation error is
            worth; 0 ignores the orientation.
        options: How many steps at most, and whether to keep them.
    """
    q, damping = q0, _DAMPING_START
    trace = [q0]
    here = _linearise(chain, target, q, turn_weight_m_rad)
    steps = 0
    while steps < (options.max_iterations or _MAX_ITERATIONS):
        gradient = here.gradient
        free = ~_pressed(gradient, q, chain)
        if float(np.abs(gradient * free).max()) < _GRADIENT_END or damping > _DAMPING_MAX:
            break
        low = np.maximum(chain.lower_rad - q, -_TRUST_RAD)
        high = np.minimum(chain.upper_rad - q, _TRUST_RAD)
        step = _bounded_step(here.curvature(damping), gradient, free, low, high)
        if float(np.abs(step).max()) < _STEP_END:
            break
        steps += 1
        tried = chain.clip(q + step)
        there = _linearise(chain, target, tried, turn_weight_m_rad)
        if there.cost < here.cost:
            q, here = tried, there
            damping = max(damping * 0.1, _DAMPING_MIN)
            trace.append(q)
        else:
            damping *= 10.0
    return Descent(q, steps, tuple(trace) if options.trace else ())


def _descend_by_priority(chain: Chain, target: Target, seed: Vector, options: Options) -> Descent:
    descent = descend(chain, target, seed, _TURN_WEIGHT_M_RAD, options)
    if target.only_position or chain.dof >= _FULL_POSE_DOF:
        return descent
    # Position first: from the best compromise walk to the nearest joints that meet the point.
    met = descend(chain, target, descent.q, 0.0, options)
    return Descent(met.q, descent.iterations + met.iterations, descent.trace + met.trace[1:])


@dataclass(frozen=True, slots=True, eq=False)
class _Local:
    """The error E = M - f(q) at one q, with its first and second derivatives."""

    error: Vector
    J: Matrix
    bend: Matrix

    @property
    def cost(self) -> float:
        return float(self.error @ self.error)

    @property
    def gradient(self) -> Vector:
        """Of half the cost."""
        return -self.J.T @ self.error

    def curvature(self, damping: float) -> Matrix:
        """Return the damped second derivative of half the cost (dof, dof)."""
        H = self.J.T @ self.J
        size = max(float(np.trace(H)), 1e-12)
        H += self.bend
        H[np.diag_indices_from(H)] += damping * size
        return H


def _linearise(chain: Chain, target: Target, q: Vector, weight: float) -> _Local:
    """Look at the error around q, orientation rows weighted."""
    T, J = chain.linearise(q, target.frame, target.offset_m)
    position_error = target.position - T[:3, 3]
    bend = _bend(J, position_error)
    if weight == 0.0 or target.only_position:
        return _Local(position_error, J[:3], bend)
    turn_error = weight * target.turn_left(T[:3, :3])
    error = np.concatenate([position_error, turn_error])
    return _Local(error, _turn_rows(J, T, target, weight), bend)


def _bend(J: Matrix, error: Vector) -> Matrix:
    """Return the part of the error's second derivative (dof, dof) that the Jacobian leaves out.

    Turning joint i swings the column of every joint j behind it: dJ_j/dq_i = axis_i x J_j. Near a
    solution this vanishes with the error; towards a point out of reach it is what matters.
    """
    swing = np.cross(J[3:].T[:, None, :], J[:3].T[None, :, :]) @ error
    upper = np.triu(swing)
    return -(upper + np.triu(swing, 1).T)


def _turn_rows(J: Matrix, T: Matrix, target: Target, weight: float) -> Matrix:
    """Weight the angular rows; a wanted direction does not care for turns about itself."""
    angular = J[3:]
    if target.rotation is None:
        axis = T[:3, :3] @ target.axis
        angular = angular - np.outer(axis, axis @ angular)
    return np.vstack([J[:3], weight * angular])


def _bounded_step(
    H: Matrix, gradient: Vector, free: NDArray[np.bool_], low: Vector, high: Vector
) -> Vector:
    """Return the step inside ``low <= step <= high`` that brings the model down (lecture L9).

    Only free joints move. Those that would leave their range are set on its end one round after
    another, and the others are solved again for what is left.
    """
    step = np.zeros(len(gradient))
    free = free.copy()
    while free.any():
        rest = gradient[free] + H[np.ix_(free, ~free)] @ step[~free]
        step[free] = _downhill(H[np.ix_(free, free)], rest)
        outside = free & ((step < low) | (step > high))
        if not outside.any():
            break
        step[outside] = np.clip(step[outside], low[outside], high[outside])
        free &= ~outside
    return step


def _downhill(H: Matrix, gradient: Vector) -> Vector:
    """Return the Newton step with every direction's curvature taken as positive."""
    curvatures, directions = np.linalg.eigh(H)
    sizes = np.maximum(np.abs(curvatures), 1e-12 * float(np.abs(curvatures).max()) + 1e-300)
    return (-directions @ ((directions.T @ gradient) / sizes)).astype(np.float64)


def _pressed(gradient: Vector, q: Vector, chain: Chain) -> NDArray[np.bool_]:
    """Return the joints (dof,) that stand at a limit and would go on if they could."""
    return ((q <= chain.lower_rad) & (gradient > 0)) | ((q >= chain.upper_rad) & (gradient < 0))
