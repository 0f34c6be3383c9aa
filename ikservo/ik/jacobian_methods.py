"""Jacobian methods: pseudo-inverse and transpose, and their step rules.

Close to a solution the pseudo-inverse is Newton's method, and each step doubles the number of
correct digits. Its steps are not checked: the error may grow in between, and at the edge of the
reach the joints may oscillate by the maximum step of 2°. The result is the best iterate.

A force F at the tip and the torques τ of compliant joints do the same virtual work, ``Fᵀ J dq = τᵀ
dq``, hence ``τ = Jᵀ F``. With E as the force, ``Δ = α Jᵀ E`` is steepest descent on ``|E|²``. This
method is cheap and never ends further from the target than it began. It is slow, because it moves
all joints as if they had the same lever.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ikservo.errors import BadValueError
from ikservo.ik.problem import Options, Posture, Target, Tolerance
from ikservo.ik.result import Result, evaluate
from ikservo.kinematics import Chain, finite_vector
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.se3 import skew

ORIENTATION_LEVER_M = 0.1
"""Position error [m] that counts as much as one radian, about half the length of a small arm."""


@dataclass(frozen=True, slots=True, eq=False)
class Linearisation:
    """The error at one q, and how each joint changes it.

    Attributes:
        q: Joints (dof,), rad or m.
        E: The residual M - f(q) (m,), metres.
        J: df/dq (m, dof), metres per rad or m.
        axes: The rotation axis of each joint (3, dof), rad per rad; 0 for a prismatic joint.
    """

    q: Vector
    E: Vector
    J: Matrix
    axes: Matrix

    @property
    def cost(self) -> float:
        """The squared error ``|E|²`` [m²], which every method minimises."""
        return float(self.E @ self.E)


class ResidualFunction:
    """The residual of a target as a function of the joints.

    f(q) stacks the point and, for a direction or an orientation, the tips of the tool's axes a
    lever's length away: one axis for a direction, all three for an orientation. So every row is in
    metres, and a position and an orientation can be weighed against each other.
    """

    def __init__(self, chain: Chain, target: Target) -> None:
        self.chain, self.target = chain, target
        # The tool axes (k, 3) that count, in the tool's coordinates, and their target directions.
        self._axes_tool = target_axes = np.zeros((0, 3))
        if target.rotation is not None:
            # A small rotation moves two of three axes, so the weight is divided between those two.
            weight_m = ORIENTATION_LEVER_M / math.sqrt(2.0)
            self._axes_tool, target_axes = weight_m * np.eye(3), weight_m * target.rotation.T
        elif target.target_axis is not None:
            self._axes_tool = ORIENTATION_LEVER_M * target.axis[None, :]
            target_axes = ORIENTATION_LEVER_M * target.target_axis[None, :]
        self._M = np.concatenate([target.position, target_axes.ravel()])

    def linearise(self, q: Vector) -> Linearisation:
        """Compute the error and its derivatives at joints (dof,)."""
        T, J = self.chain.forward_and_jacobian(q, self.target.frame, self.target.offset_m)
        axes = self._axes_tool @ T[:3, :3].T
        f = np.concatenate([T[:3, 3], axes.ravel()])
        swings = [-skew(axis) @ J[3:] for axis in axes]  # ω × a = -a × ω
        return Linearisation(q, self._M - f, np.vstack([J[:3], *swings]), J[3:])

    def is_met(self, current: Linearisation, tolerance: Tolerance) -> bool:
        """Check whether the residual is at most half the tolerance.

        The other half is for rounding before the result is returned.
        """
        gap_m = _vector_length(current.E[:3])
        rotation_rad = _vector_length(current.E[3:]) / ORIENTATION_LEVER_M
        half_m, half_rad = 0.5 * tolerance.position_m, 0.5 * tolerance.orientation_rad
        return gap_m <= half_m and rotation_rad <= half_rad


def active_limits(chain: Chain, q: Vector, tau: Vector) -> NDArray[np.bool_]:
    """Find the joints (dof,) at a limit against which tau (dof,) pulls them."""
    return ((q <= chain.lower_rad) & (tau < 0.0)) | ((q >= chain.upper_rad) & (tau > 0.0))


def _vector_length(v: Vector) -> float:
    return math.sqrt(float(v @ v))


MAX_STEP_RAD = math.radians(2.0)
"""The maximum step of a joint: 2°, or the same number of metres (35 mm) if it is prismatic."""

# A step this small moves the tool by less than a nanometre.
_STEP_END = 1e-9
# An iteration whose error falls by less in this many steps has stalled.
_MAX_STALLED_STEPS = 50
_PROGRESS = 0.999  # fraction to which the error must fall
_PROGRESS_M = 1e-6  # or the length by which it must fall
# The effect of a step halved this many times is lost in the rounding of the error.
_HALVINGS = 40

Step = Callable[[Linearisation], Linearisation]
"""One iteration of a method: from the present linearisation to the one after the step."""


def scale_step(step: Vector) -> Vector:
    """Compute the step (dof,), scaled as a whole so that no joint moves further than 2°."""
    largest = float(np.abs(step).max(initial=0.0))
    return step if largest <= MAX_STEP_RAD else step * (MAX_STEP_RAD / largest)


def backtrack(task: ResidualFunction, current: Linearisation, step: Vector) -> Linearisation:
    """Take the step (dof,), halved until the error does not increase; stay if it always does."""
    for _ in range(_HALVINGS):
        moved = task.linearise(task.chain.clip(current.q + step))
        if moved.cost <= current.cost:
            return moved
        step = 0.5 * step
    return current


def iterate(
    method: str,
    step: Step,
    task: ResidualFunction,
    q0: Vector,
    options: Options,
    max_iterations: int,
    *,
    until_rest: bool = False,
) -> Result:
    """Take steps from ``q0`` (dof,) until the target is met, nothing moves, or no step is left.

    There is one start and no restart: a search that stalls ends. The result is the best iterate. A
    start outside the limits, rad or m, is first clipped to them. ``max_iterations`` is the default
    if the options do not limit the number of steps; ``until_rest`` continues after the target is
    met, until nothing moves.
    """
    iteration = _Iteration(task, options.tolerance, task.linearise(task.chain.clip(q0)))
    for _ in range(options.max_iterations or max_iterations):
        if iteration.is_finished(until_rest=until_rest):
            break
        iteration.move_to(step(iteration.current))
    return evaluate(
        task.chain,
        task.target,
        iteration.best.q,
        options.tolerance,
        method=method,
        iterations=len(iteration.trace) - 1,
        trace=tuple(iteration.trace) if options.trace else (),
    )


class _Iteration:
    """The present and the best iterate, and the number of steps without progress."""

    def __init__(self, task: ResidualFunction, tolerance: Tolerance, start: Linearisation) -> None:
        self.current = self.best = start
        self.trace = [start.q]
        self._task, self._tolerance = task, tolerance
        self._met = task.is_met(start, tolerance)
        self._still, self._mark_m, self._since = False, math.sqrt(start.cost), 0

    def is_finished(self, *, until_rest: bool) -> bool:
        return self._still or self._since > _MAX_STALLED_STEPS or (self._met and not until_rest)

    def move_to(self, moved: Linearisation) -> None:
        self._still = float(np.abs(moved.q - self.current.q).max()) <= _STEP_END
        self._met = self._task.is_met(moved, self._tolerance)
        if self._met or moved.cost < self.best.cost:
            self.best = moved
        residual_m = math.sqrt(moved.cost)
        if self._met or residual_m < max(_PROGRESS * self._mark_m, self._mark_m - _PROGRESS_M):
            self._mark_m, self._since = residual_m, 0
        else:
            self._since += 1
        self.current = moved
        self.trace.append(moved.q)


EPSILON = 5e-3
"""Singular values below this fraction of the largest count as zero.

This value is about the radial singular value one degree before the arm is stretched. With a smaller
value, the iteration would oscillate through the stretched pose forever, 2° back and forth; with a
larger value, it would stop early.
"""

_PINV_MAX_ITERATIONS = 500


def pseudo_inverse(chain: Chain, target: Target, q0: Vector, options: Options) -> Result:
    """Iterate from ``q0`` in small steps that solve the linearised problem.

    With a posture in the options the joints move towards it as far as the target leaves freedom,
    and the iteration ends when nothing moves any more.

    Raises:
        BadValueError: The posture has the wrong shape, is not finite, or a weight is negative.
    """
    task = ResidualFunction(chain, target)
    preferred, weights = _posture_gradient(chain, options.posture)

    def step(current: Linearisation) -> Linearisation:
        C = weights * (current.q - preferred)
        return task.linearise(chain.clip(current.q + limited_step(current, chain, C)))

    until_rest = options.posture is not None
    return iterate(
        "pseudo_inverse", step, task, q0, options, _PINV_MAX_ITERATIONS, until_rest=until_rest
    )


_NOTHING = 1e-150  # the reciprocal of a smaller number could overflow


def pinv(J: Matrix, epsilon: float = EPSILON) -> Matrix:
    """Compute the pseudo-inverse (n, m) of J (m, n) by truncated SVD.

    ``J = U S Vᵀ``, ``J⁺ = V S⁻¹ Uᵀ`` with ``1/s := 0`` if ``s < ε s_max``. ``Δ = J⁺ E`` is the
    least-squares solution of ``J Δ = E`` if no solution is exact, and the solution of least norm if
    there are many.
    """
    U, s, Vt = np.linalg.svd(J, full_matrices=False)
    kept = s > max(epsilon * s.max(initial=0.0), _NOTHING)
    return (Vt[kept].T / s[kept]) @ U[:, kept].T


def nullspace_step(J: Matrix, E: Vector, C: Vector) -> Vector:
    """Return ``Δ = J⁺ E + (J⁺ J - I) C`` (dof,).

    The second part moves along ``-C`` without moving the tip: ``J (J⁺ J - I) = 0``.
    """
    J_plus = pinv(J)
    return J_plus @ (E + J @ C) - C


def limited_step(current: Linearisation, chain: Chain, C: Vector) -> Vector:
    """Compute the step (dof,), which moves no joint by more than 2° or beyond its limits.

    The step of a joint that would leave its range ends on the limit. The joint's column is removed,
    and the other joints are solved again for the remaining error, until no joint leaves its range.
    A joint that the error pulls against its limit is removed from the beginning, because the
    iteration could otherwise end while the other joints still had a descent direction. Every
    iteration starts with all joints, so that a joint can leave its limit again.
    """
    to_lower, to_upper = chain.lower_rad - current.q, chain.upper_rad - current.q
    step, free = np.zeros(chain.dof), ~active_limits(chain, current.q, current.J.T @ current.E - C)
    while free.any():
        remaining = current.E - current.J[:, ~free] @ step[~free]
        step[free] = scale_step(nullspace_step(current.J[:, free], remaining, C[free]))
        leaves = free & ((step < to_lower) | (step > to_upper))
        if not leaves.any():
            break
        step[leaves] = np.clip(step[leaves], to_lower[leaves], to_upper[leaves])
        free &= ~leaves
    return step


def _posture_gradient(chain: Chain, posture: Posture | None) -> tuple[Vector, Vector]:
    """Return ``q_pref`` and ``w`` of ``C_i = w_i (q_i - q_pref,i)``, both (dof,)."""
    if posture is None:
        return np.zeros(chain.dof), np.zeros(chain.dof)
    weights = finite_vector(posture.weights, chain.dof, "The vector of weights")
    if (weights < 0.0).any():
        raise BadValueError("A posture's weight", float(weights.min()), "a number of 0 or more")
    # A weight of 1 reaches the posture in one step; a weight of 2 would oscillate forever.
    return finite_vector(posture.q, chain.dof, "The posture"), weights / max(1.0, weights.max())


_MAX_TRANSPOSE_ITERATIONS = 2000


def transpose(chain: Chain, target: Target, q0: Vector, options: Options) -> Result:
    """Follow the negative gradient of the error from ``q0``, always downhill."""
    task = ResidualFunction(chain, target)

    def step(current: Linearisation) -> Linearisation:
        tau = gradient_torque(current, chain)
        return backtrack(task, current, scale_step(step_length(current.J, current.E, tau) * tau))

    return iterate("transpose", step, task, q0, options, _MAX_TRANSPOSE_ITERATIONS)


def gradient_torque(current: Linearisation, chain: Chain) -> Vector:
    """Return ``τ = Jᵀ E`` (dof,); 0 for a joint that is pulled against its limit."""
    tau = current.J.T @ current.E
    return np.where(active_limits(chain, current.q, tau), 0.0, tau)


def step_length(J: Matrix, E: Vector, tau: Vector) -> float:
    """Compute the α that minimises the linearised error ``|E - α J τ|``.

    ``α = (E · J τ) / |J τ|²``; zero if τ does not move the tip.
    """
    lift = J @ tau
    size = float(lift @ lift)
    return float(E @ lift) / size if size > 0.0 else 0.0
