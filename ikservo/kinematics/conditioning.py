"""Manipulability and the distance to the nearest singularity, lengths and angles kept apart.

Singular values of a Jacobian whose rows are metres and radians mean nothing together. Here the
linear rows are evaluated first, and of the angular rows the part for joint motions that leave
the point at rest: the arm loses a direction of its pose exactly where one of the two is zero.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ikservo.kinematics.arrays import Matrix, Vector, finite_vector
from ikservo.kinematics.chain import Chain

__all__ = [
    "Conditioning",
    "Singularity",
    "conditioning",
    "distance_to_limits",
    "manipulability",
    "nearest_singularity",
    "ordinary_postures",
]


def manipulability(J: Matrix) -> Vector:
    """Return Yoshikawa's measure ``sqrt(det(J Jᵀ))`` (), or (n,) for many Jacobians.

    Zero where the tool cannot move in some direction of the given rows. Use the three linear
    rows for positions ``J[..., :3, :]`` [m³], all six for poses.

    Source: T. Yoshikawa, Manipulability of Robotic Mechanisms, IJRR 4(2), 1985. With fewer
    joints than rows, the product of the singular values.
    """
    return np.prod(np.linalg.svd(J, compute_uv=False), axis=-1)


def distance_to_limits(chain: Chain, q: ArrayLike) -> Vector:
    """Return (dof,) or (n, dof): the distance of each joint to its nearer limit, rad or m.

    Negative outside, infinite for a continuous joint.
    """
    joints = np.asarray(q, dtype=np.float64)
    return np.minimum(joints - chain.lower_rad, chain.upper_rad - joints)


# Singular values below this fraction of the largest are zero in every sampled posture.
_RANK = 1e-7
_SAMPLES = 5
_IRRATIONAL = np.sqrt(np.array([2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0]))
_STEPS, _HALVINGS = 40, 6
# A singular value is zero where it is this fraction of its start, or of one metre or radian.
_ZERO = 1e-6
_DIFFERENCE_RAD = 1e-6
_MAX_STEP_RAD = 0.3
# Offset of each joint to either side of a posture, for further start postures.
_START_OFFSET_RAD = 0.7
_MIN_DERIVATIVE = 1e-300

Measure = Callable[[Vector], Vector]
"""From joints (n, dof) to a singular value of each (n,)."""


@dataclass(frozen=True, slots=True, eq=False)
class Conditioning:
    """The mobility of one point of the arm in one posture.

    A metre of a prismatic joint counts as a radian.

    Attributes:
        manipulability: Yoshikawa's measure, the product of ``moves_m_rad`` [m³ where it has three].
        moves_m_rad: The motion of the point for a radian of joint motion along each of its
            principal directions, the largest first [m/rad]: the singular values of the linear
            rows. As many as the arm has at all, 2 in a plane.
        turns_rad_rad: The rotation of its link for a radian of joint motion that leaves the point
            at rest, likewise [rad/rad]; empty if there is no such motion.
    """

    manipulability: float
    moves_m_rad: Vector
    turns_rad_rad: Vector

    @property
    def slowest_m_rad(self) -> float:
        """Return the motion of the point in its worst direction [m/rad]; 0 where singular."""
        return float(self.moves_m_rad.min(initial=math.inf))

    @property
    def slowest_rotation_rad_rad(self) -> float:
        """Return the minimum rotation of the link with the point at rest; inf if there is none."""
        return float(self.turns_rad_rad.min(initial=math.inf))


@dataclass(frozen=True, slots=True, eq=False)
class Singularity:
    """A singular posture.

    Attributes:
        q: The posture (dof,), inside the limits.
        distance_rad: Its distance in joint space, the root of the summed squares.
        joint: The joint with the largest distance to it.
    """

    q: Vector
    distance_rad: float
    joint: str


def conditioning(
    chain: Chain, q: ArrayLike, frame: str | None = None, offset_m: ArrayLike | None = None
) -> Conditioning:
    """Compute the mobility of a point at joints (dof,).

    Args:
        chain: The arm.
        q: The posture (dof,), rad or m.
        frame: Name of a link; the tip if None.
        offset_m: A point (3,) in that link's coordinates, metres; its origin if None.

    Raises:
        BadValueError: ``q`` or ``offset_m`` has a wrong shape or is not finite.
        UnknownNameError: No link is named ``frame``.
    """
    q = finite_vector(q, chain.dof, "q")
    moves, rotations = _count_freedoms(chain, frame, offset_m)
    J = chain.jacobian(q, frame, offset_m)
    moves_m_rad = _linear_singular_values(J, moves)
    return Conditioning(
        float(np.prod(moves_m_rad)), moves_m_rad, _angular_singular_values(J, moves, rotations)
    )


def nearest_singularity(
    chain: Chain,
    q: ArrayLike,
    frame: str | None = None,
    offset_m: ArrayLike | None = None,
    *,
    rotation: bool = False,
) -> Singularity | None:
    """Search from joints (dof,) a singular posture of a point nearby.

    Newton's steps reduce the smallest singular value to zero inside the limits, from the posture
    and from some around it. The result is singular for certain, and seldom is another nearer;
    None if none is found.

    Args:
        chain: The arm.
        q: The start (dof,), rad or m; joints outside the limits are clipped to them first.
        frame: Name of a link; the tip if None.
        offset_m: A point (3,) in that link's coordinates, metres; its origin if None.
        rotation: Whether a posture counts as well in which the link loses a rotation with the
            point at rest.

    Raises:
        BadValueError: ``q`` or ``offset_m`` has a wrong shape or is not finite.
        UnknownNameError: No link is named ``frame``.
    """
    start = chain.clip(finite_vector(q, chain.dof, "q"))
    starts = _start_postures(chain, start)
    measures = _singularity_measures(chain, frame, offset_m, rotation)
    ends = np.vstack([np.zeros((0, chain.dof)), *(_find_zeros(chain, starts, m) for m in measures)])
    if not len(ends):
        return None
    apart = np.linalg.norm(ends - start, axis=1)
    end = ends[int(np.argmin(apart))]
    joint = chain.names[int(np.argmax(np.abs(end - start)))]
    return Singularity(end, float(apart.min()), joint)


def _singularity_measures(
    chain: Chain, frame: str | None, offset_m: ArrayLike | None, rotation: bool
) -> list[Measure]:
    moves, rotations = _count_freedoms(chain, frame, offset_m)
    measures: list[Measure] = []
    if moves:
        measures.append(
            lambda q: _linear_singular_values(chain.jacobian(q, frame, offset_m), moves)[..., -1]
        )
    if rotation and rotations:
        measures.append(
            lambda q: _angular_singular_values(
                chain.jacobian(q, frame, offset_m), moves, rotations
            )[..., -1]
        )
    return measures


def _start_postures(chain: Chain, q: Vector) -> Matrix:
    """Return the start postures (2 dof + 1, dof): q, and with one joint moved either way."""
    aside = _START_OFFSET_RAD * np.eye(chain.dof)
    starts: Matrix = chain.clip(np.vstack([q[None], q + aside, q - aside]))
    return starts


def _find_zeros(chain: Chain, q: Matrix, measure: Measure) -> Matrix:
    """Return the zeros (n, dof) of a measure found by searches from joints (m, dof)."""
    values = measure(q)
    zero, ends = _ZERO * np.minimum(values, 1.0), [q[:0]]
    for _ in range(_STEPS):
        done = values <= zero
        ends.append(q[done])
        q, values, zero = q[~done], values[~done], zero[~done]
        if not len(q):
            break
        moved, lower = _newton_step(chain, q, values, measure)
        falls = lower < values
        q, values, zero = moved[falls], lower[falls], zero[falls]
    return np.vstack(ends)


def _newton_step(
    chain: Chain, q: Matrix, values: Vector, measure: Measure
) -> tuple[Matrix, Vector]:
    """Take Newton's step, or its half, quarter, … that lowers the measure most."""
    slope = _measure_gradient(chain, q, measure)
    size2 = np.maximum(np.sum(slope * slope, axis=1), _MIN_DERIVATIVE)
    step = -(values / size2)[:, None] * slope
    max_step_rad = np.maximum(np.abs(step).max(axis=1), _MAX_STEP_RAD)
    fractions = 0.5 ** np.arange(_HALVINGS)
    candidates = (
        q[:, None] + fractions[None, :, None] * (_MAX_STEP_RAD / max_step_rad * step.T).T[:, None]
    )
    inside = chain.clip(candidates.reshape(-1, chain.dof))
    values_after = measure(inside).reshape(len(q), _HALVINGS)
    candidates = inside.reshape(candidates.shape)
    best = np.argmin(values_after, axis=1)
    rows = np.arange(len(q))
    return candidates[rows, best], values_after[rows, best]


def _measure_gradient(chain: Chain, q: Matrix, measure: Measure) -> Matrix:
    """Return the derivative (n, dof); 0 for joints at a limit that would move outside."""
    aside = _DIFFERENCE_RAD * np.eye(chain.dof)
    beside = np.concatenate([q[:, None] + aside, q[:, None] - aside], axis=1)
    plus, minus = np.split(measure(beside.reshape(-1, chain.dof)).reshape(len(q), -1), 2, axis=1)
    slope = (plus - minus) / (2.0 * _DIFFERENCE_RAD)
    blocked = ((q <= chain.lower_rad) & (slope > 0.0)) | ((q >= chain.upper_rad) & (slope < 0.0))
    return np.where(blocked, 0.0, slope)


def _linear_singular_values(J: Matrix, count: int) -> Vector:
    """Return the largest singular values (count,) or (n, count) of the linear rows."""
    return _singular_values(J[..., :3, :])[..., :count]


def _angular_singular_values(J: Matrix, moves: int, count: int) -> Vector:
    """Return those of the angular rows for joint motions that leave the point at rest."""
    _, _, Vt = np.linalg.svd(J[..., :3, :], full_matrices=True)
    null_space = np.swapaxes(Vt[..., moves:, :], -1, -2)
    if not count:
        return np.zeros((*J.shape[:-2], 0))
    return _singular_values(J[..., 3:, :] @ null_space)[..., :count]


def ordinary_postures(dof: int) -> Matrix:
    """Return a few postures (n, dof) that are singular for no arm: irrational revolutions."""
    revolutions = (0.5 + np.outer(np.arange(1, _SAMPLES + 1), _IRRATIONAL)) % 1.0
    q: Matrix = np.resize(2.0 * math.pi * revolutions, (_SAMPLES, dof)).astype(np.float64)
    return q


def _count_freedoms(chain: Chain, frame: str | None, offset_m: ArrayLike | None) -> tuple[int, int]:
    """Return the numbers of directions of the point, and of rotations of the link about it."""
    J = chain.jacobian(ordinary_postures(chain.dof), frame, offset_m)
    moves = _numerical_rank(_singular_values(J[:, :3]))
    _, _, Vt = np.linalg.svd(J[:, :3], full_matrices=True)
    rotating = J[:, 3:] @ np.swapaxes(Vt[:, moves:, :], 1, 2)
    return moves, _numerical_rank(_singular_values(rotating)) if moves < chain.dof else 0


def _numerical_rank(values: Matrix) -> int:
    """Return how many singular values (samples, k) are not zero in every sample."""
    return int((values > _RANK * max(values.max(initial=0.0), 1e-300)).sum(axis=1).max(initial=0))


def _singular_values(matrices: Matrix) -> Matrix:
    values: Matrix = np.linalg.svd(matrices, compute_uv=False).astype(np.float64, copy=False)
    return values
