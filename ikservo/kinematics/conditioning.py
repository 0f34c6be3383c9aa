"""Manipulability and distance to the nearest singularity, with lengths and angles kept apart.

Singular values of a Jacobian with rows in both metres and radians have no meaning. Here the linear
rows are evaluated first, then the angular rows for joint motions that leave the point at rest. The
pose loses a degree of freedom exactly if a singular value of either group of rows is zero.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ikservo.kinematics.arrays import FrozenArrays, Matrix, Vector, finite_vector
from ikservo.kinematics.chain import Chain


def manipulability(J: Matrix) -> Vector:
    """Return Yoshikawa's measure ``sqrt(det(J Jᵀ))`` (), or (n,) for many Jacobians.

    It is zero if the tool cannot move in some direction of the given rows. Use the three linear
    rows for positions ``J[..., :3, :]`` [m³], all six for poses.

    Source: T. Yoshikawa, Manipulability of Robotic Mechanisms, IJRR 4(2), 1985. With fewer
    joints than rows it is the product of the singular values.
    """
    return np.prod(np.linalg.svd(J, compute_uv=False), axis=-1)


def distance_to_limits(chain: Chain, q: ArrayLike) -> Vector:
    """Return the distance (dof,) or (n, dof) from each joint to its nearer limit, rad or m.

    It is negative outside the limits, and infinite for a continuous joint.
    """
    joints = np.asarray(q, dtype=np.float64)
    return np.minimum(joints - chain.lower_rad, chain.upper_rad - joints)


# Singular values that are below this in every sampled posture are zero, m/rad or rad/rad.
_RANK = 1e-9
_SAMPLES = 5
_STEPS = 40
_FRACTIONS = 0.5 ** np.arange(6)  # fractions of Newton's step that are tried
_ZERO = 1e-6  # a posture with a singular value below this is singular, m/rad or rad/rad
_DIFFERENCE_RAD = 1e-6
_MAX_STEP_RAD = 0.3
# Offset of each joint to either side of the given posture, for further start postures.
_START_OFFSET_RAD = 0.7
_MIN_DERIVATIVE = 1e-300

Measure = Callable[[Vector], Vector]
"""Takes joint vectors (n, dof); returns a singular value for each (n,)."""


@dataclass(frozen=True, slots=True, eq=False)
class Conditioning(FrozenArrays):
    """The mobility of a point of the arm in a posture.

    One metre of a prismatic joint counts as one radian.

    Attributes:
        manipulability: Yoshikawa's measure, the product of ``moves_m_rad`` [m³ if it has three].
        moves_m_rad: Motion of the point per radian of joint motion along each of its principal
            directions, the largest first [m/rad]: the singular values of the linear rows. Their
            number is the arm's degrees of freedom for positions, 2 in a plane.
        turns_rad_rad: Rotation of the point's link about each of its principal directions, per
            radian of joint motion that leaves the point at rest [rad/rad]; empty without such
            motions.
    """

    manipulability: float
    moves_m_rad: Vector
    turns_rad_rad: Vector

    @property
    def slowest_m_rad(self) -> float:
        """Motion of the point in its worst direction [m/rad]; 0 if singular."""
        return float(self.moves_m_rad.min(initial=math.inf))


@dataclass(frozen=True, slots=True, eq=False)
class Singularity(FrozenArrays):
    """A singular posture.

    Attributes:
        q: The posture (dof,), inside the limits.
        distance_rad: Euclidean distance from the given posture in joint space.
        joint: The joint with the largest difference between the two postures.
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
        offset_m: A point (3,) in that link's coordinates, metres; the link's origin if None.

    Raises:
        BadValueError: ``q`` or ``offset_m`` has a wrong shape or is not finite.
        UnknownNameError: There is no link named ``frame``.
    """
    q = finite_vector(q, chain.dof, "q")
    moves, rotations = _count_freedoms(chain, frame, offset_m)
    J = chain.jacobian(q, frame, offset_m)
    moves_m_rad = _linear_singular_values(J)[:moves]
    return Conditioning(
        float(np.prod(moves_m_rad)), moves_m_rad, _angular_singular_values(J, moves)[:rotations]
    )


def nearest_singularity(
    chain: Chain,
    q: ArrayLike,
    frame: str | None = None,
    offset_m: ArrayLike | None = None,
    *,
    rotation: bool = False,
) -> Singularity | None:
    """Search near joints (dof,) for a singular posture of a point.

    Newton's steps reduce the smallest singular value to zero inside the limits, from the given
    posture and from some postures around it. The posture found is certainly singular, but another
    singular posture may be nearer. The result is None if no singular posture is found.

    Args:
        chain: The arm.
        q: The start (dof,), rad or m; joints outside the limits are clipped to them first.
        frame: Name of a link; the tip if None.
        offset_m: A point (3,) in that link's coordinates, metres; the link's origin if None.
        rotation: Whether a posture also counts if the link loses a rotation with the point at
            rest.

    Raises:
        BadValueError: ``q`` or ``offset_m`` has a wrong shape or is not finite.
        UnknownNameError: There is no link named ``frame``.
    """
    start = chain.clip(finite_vector(q, chain.dof, "q"))
    # The given posture, and the same with each joint moved to either side (2 dof + 1, dof).
    aside = _START_OFFSET_RAD * np.eye(chain.dof)
    starts = chain.clip(np.vstack([start[None], start + aside, start - aside]))
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
            lambda q: _linear_singular_values(chain.jacobian(q, frame, offset_m))[..., moves - 1]
        )
    if rotation and rotations:
        measures.append(
            lambda q: _angular_singular_values(chain.jacobian(q, frame, offset_m), moves)[
                ..., rotations - 1
            ]
        )
    return measures


def _find_zeros(chain: Chain, q: Matrix, measure: Measure) -> Matrix:
    """Find zeros (n, dof) of a measure by searches from joints (m, dof)."""
    values = measure(q)
    ends: list[Matrix] = []
    for _ in range(_STEPS):
        ends.append(q[values <= _ZERO])
        q, values = q[values > _ZERO], values[values > _ZERO]
        if not len(q):
            break
        moved, lower = _newton_step(chain, q, values, measure)
        q, values = moved[lower < values], lower[lower < values]
    return np.vstack(ends)


def _newton_step(
    chain: Chain, q: Matrix, values: Vector, measure: Measure
) -> tuple[Matrix, Vector]:
    """Take Newton's step, or its half, quarter, … that lowers the measure most."""
    aside = _DIFFERENCE_RAD * np.eye(chain.dof)
    beside = measure((q[:, None] + aside).reshape(q.size, chain.dof)).reshape(q.shape)
    slope = (beside - values[:, None]) / _DIFFERENCE_RAD
    downhill = chain.clip(q - np.copysign(_DIFFERENCE_RAD, slope))
    slope = np.where(downhill == q, 0.0, slope)  # a joint at a limit does not move outside
    size2 = np.maximum(np.sum(slope * slope, axis=1), _MIN_DERIVATIVE)
    step = -(values / size2)[:, None] * slope
    max_step_rad = np.maximum(np.linalg.norm(step, np.inf, axis=1), _MAX_STEP_RAD)
    step *= (_MAX_STEP_RAD / max_step_rad)[:, None]
    candidates = chain.clip(np.vstack([q + fraction * step for fraction in _FRACTIONS]))
    values_after = measure(candidates).reshape(len(_FRACTIONS), len(q))
    best = np.argmin(values_after, axis=0) * len(q) + np.arange(len(q))
    return candidates[best], values_after.ravel()[best]


def _linear_singular_values(J: Matrix) -> Vector:
    """Return the singular values (k,) or (n, k) of the linear rows, the largest first."""
    return _singular_values(J[..., :3, :])


def _angular_singular_values(J: Matrix, moves: int) -> Vector:
    """Return singular values of the angular rows for joint motions that leave the point at rest."""
    _, _, Vt = np.linalg.svd(J[..., :3, :], full_matrices=True)
    null_space = np.swapaxes(Vt[..., moves:, :], -1, -2)
    return _singular_values(J @ null_space)  # along these motions the linear rows are zero


def _singular_values(matrices: Matrix) -> Matrix:
    return np.asarray(np.linalg.svd(matrices, compute_uv=False), dtype=np.float64)


def ordinary_postures(dof: int) -> Matrix:
    """Return a few postures (n, dof) that are not singular for any arm.

    Each joint is at a different integer number of radians, never a fraction of a revolution.
    """
    return np.arange(1, _SAMPLES * dof + 1, dtype=np.float64).reshape(_SAMPLES, dof) % math.tau


def _count_freedoms(chain: Chain, frame: str | None, offset_m: ArrayLike | None) -> tuple[int, int]:
    """Count the directions in which the point can move, and the rotations of the link about it."""
    J = chain.jacobian(ordinary_postures(chain.dof), frame, offset_m)
    moves = _numerical_rank(_linear_singular_values(J))
    return moves, _numerical_rank(_angular_singular_values(J, moves))


def _numerical_rank(values: Matrix) -> int:
    """Return how many singular values (samples, k) are not zero in every sample."""
    return int((values > _RANK).sum(axis=1).max())
