"""The pseudo-inverse method (lecture L7 to L10): ``J Δ = E`` solved again and again, 2° at a time.

Close to a solution this is Newton's method and each step doubles the digits. It does not ask
whether a step was good: the error may grow on the way, and at the edge of the reach the joints
may swing back and forth by the 2° they are allowed. The answer is the best iterate.
"""

from __future__ import annotations

import numpy as np

from ikservo.errors import BadValueError
from ikservo.ik.options import Options, Posture
from ikservo.ik.result import Result
from ikservo.ik.small_steps import iterate, small
from ikservo.ik.target import Target
from ikservo.ik.task import Local, Task, pressed
from ikservo.kinematics import Chain, finite_vector
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["EPSILON", "limited_step", "pinv", "posture_step", "pseudo_inverse"]

EPSILON = 5e-3
"""Singular values below this part of the largest count as zero (lecture L8).

About what the arm has left of the way outwards one degree before it is stretched. With less it
would swing through the stretched pose, 2° back and forth, for ever; with more it would stop early.
"""

_MAX_ITERATIONS = 500


def pseudo_inverse(chain: Chain, target: Target, q0: Vector, options: Options) -> Result:
    """Walk from ``q0`` in small steps that solve the linearised problem (lecture L7).

    With a posture in the options the walk leans towards it as far as the target leaves freedom,
    and ends when both have come to rest (lecture L10).

    Raises:
        BadValueError: The posture has the wrong shape, is not finite, or a weight is negative.
    """
    task = Task(chain, target)
    wish, weights = _lean(chain, options.posture)

    def step(here: Local) -> Local:
        C = weights * (here.q - wish)
        return task.at(chain.clip(here.q + limited_step(here, chain, C)))

    settle = options.posture is not None
    return iterate("pseudo_inverse", step, task, q0, options, _MAX_ITERATIONS, settle=settle)


_NOTHING = 1e-150  # below it even the reciprocal is no number


def pinv(J: Matrix, epsilon: float = EPSILON) -> Matrix:
    """Return the pseudo-inverse (n, m) of J (m, n) by truncated SVD (lecture L8).

    ``J = U S Vᵀ``, ``J⁺ = V S⁻¹ Uᵀ`` with ``1/s := 0`` where ``s < ε s_max``. ``Δ = J⁺ E`` is the
    least-squares solution of ``J Δ = E`` where there is none, the least norm where there are many.
    """
    U, s, Vt = np.linalg.svd(J, full_matrices=False)
    kept = s > max(epsilon * s.max(initial=0.0), _NOTHING)
    return (Vt[kept].T / s[kept]) @ U[:, kept].T


def posture_step(J: Matrix, E: Vector, C: Vector) -> Vector:
    """Return ``Δ = J⁺ E + (J⁺ J - I) C`` (dof,) (lecture L10).

    The second part goes along ``-C`` only as far as the tip does not feel it: ``J (J⁺ J - I) = 0``.
    """
    J_plus = pinv(J)
    return J_plus @ (E + J @ C) - C


def limited_step(here: Local, chain: Chain, C: Vector) -> Vector:
    """Return the step (dof,): no joint over 2° (lecture L7), none beyond its limits (L9).

    The step of a joint that would leave its range ends on the limit. Its column is struck out, and
    the others are solved again for what it leaves to them, until no joint leaves. A joint that
    stands on its limit and that the error pulls against it is struck out from the start, else the
    walk could end where the others still had a way down. Every iteration begins anew, so that a
    joint may come back off its limit.
    """
    to_lower, to_upper = chain.lower_rad - here.q, chain.upper_rad - here.q
    step, free = np.zeros(chain.dof), ~pressed(chain, here.q, here.J.T @ here.E - C)
    while free.any():
        left = here.E - here.J[:, ~free] @ step[~free]
        step[free] = small(posture_step(here.J[:, free], left, C[free]))
        leaves = free & ((step < to_lower) | (step > to_upper))
        if not leaves.any():
            break
        step[leaves] = np.clip(step[leaves], to_lower[leaves], to_upper[leaves])
        free &= ~leaves
    return step


def _lean(chain: Chain, posture: Posture | None) -> tuple[Vector, Vector]:
    """Return ``q_pref`` and ``w`` of ``C_i = w_i (q_i - q_pref,i)``, both (dof,)."""
    if posture is None:
        return np.zeros(chain.dof), np.zeros(chain.dof)
    weights = finite_vector(posture.weights, chain.dof, "The posture's weights")
    if (weights < 0.0).any():
        raise BadValueError("A posture's weight", float(weights.min()), "0 or more")
    # A weight of 1 goes all the way in one step; one of 2 would swing for ever.
    return finite_vector(posture.q, chain.dof, "The posture"), weights / max(1.0, weights.max())
