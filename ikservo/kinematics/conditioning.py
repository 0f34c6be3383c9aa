"""Manipulability and the distance to the nearest singularity, lengths and angles kept apart.

Singular values of a Jacobian whose rows are metres and radians mean nothing together. Here the
linear rows are looked at first, and of the angular rows what remains to joints that leave the
point where it is: the arm loses a direction of its pose exactly where one of the two is zero.
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

    Zero where the tool cannot move in some direction of the rows given. Take the three linear
    rows for positions ``J[..., :3, :]`` [m³], all six for poses.

    Source: T. Yoshikawa, Manipulability of Robotic Mechanisms, IJRR 4(2), 1985. With fewer
    joints than rows the product of the singular values that there are.
    """
    return np.prod(np.linalg.svd(J, compute_uv=False), axis=-1)


def distance_to_limits(chain: Chain, q: ArrayLike) -> Vector:
    """Return (dof,) or (n, dof): how far each joint is inside its nearer limit, rad or m.

    Negative outside, infinite for a continuous joint.
    """
    joints = np.asarray(q, dtype=np.float64)
    return np.minimum(joints - chain.lower_rad, chain.upper_rad - joints)


# Singular values below this part of the largest are zero in every posture that was looked at.
_RANK = 1e-7
_SAMPLES = 5
_IRRATIONAL = np.sqrt(np.array([2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0]))
_STEPS, _HALVINGS = 40, 6
# A singular value is zero where it is this part of what it was, or of one metre or radian.
_ZERO = 1e-6
_DIFFERENCE_RAD = 1e-6
_MAX_STEP_RAD = 0.3
# How far to either side of a posture each joint is turned to begin another walk.
_START_OFFSET_RAD = 0.7
_MIN_DERIVATIVE = 1e-300

Measure = Callable[[Vector], Vector]
"""From joints (n, dof) to a singular value of each (n,)."""


@dataclass(frozen=True, slots=True, eq=False)
class Conditioning:
    """How freely one point of the arm moves at one posture.

    A slide counts a metre as a radian.

    Attributes:
        manipulability: Yoshikawa's measure, the product of ``moves_m_rad`` [m³ where it has three].
        moves_m_rad: How far the point goes for a radian of joint motion along each of its principal
            directions, the easiest first [m/rad]: the singular values of the linear rows. As many
            as the arm has at all, 2 in a plane.
        turns_rad_rad: How far its link turns for a radian of joint motion that leaves the point
            where it is, likewise [rad/rad]; empty where no joint is left for that.
    """

    manipulability: float
    moves_m_rad: Vector
    turns_rad_rad: Vector

    @property
    def slowest_m_rad(self) -> float:
        """Return how far the point goes in its worst direction [m/rad]; 0 where singular."""
        return float(self.moves_m_rad.min(initial=math.inf))

    @property
    def slowest_turn_rad_rad(self) -> float:
        """Return how far the link turns at worst while the point stays; inf without such turns."""
        return float(self.turns_rad_rad.min(initial=math.inf))


@dataclass(frozen=True, slots=True, eq=False)
class Singularity:
    """A posture in which the arm has lost a direction.

    Attributes:
        q: The posture (dof,), inside the limits.
        distance_rad: How far it is in joint space, the root of the summed squares.
        joint: The joint that is the furthest from where it stands there.
    """

    q: Vector
    distance_rad: float
    joint: str


def conditioning(
    chain: Chain, q: ArrayLike, frame: str | None = None, offset_m: ArrayLike | None = None
) -> Conditioning:
    """Measure how freely a point moves at joints (dof,).

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
    moves, turns = _count_freedoms(chain, frame, offset_m)
    J = chain.jacobian(q, frame, offset_m)
    moves_m_rad = _linear_singular_values(J, moves)
    return Conditioning(
        float(np.prod(moves_m_rad)), moves_m_rad, _angular_singular_values(J, moves, turns)
    )


def nearest_singularity(
    chain: Chain,
    q: ArrayLike,
    frame: str | None = None,
    offset_m: ArrayLike | None = None,
    *,
    turning: bool = False,
) -> Singularity | None:
    """Walk from joints (dof,) to a posture nearby in which a point loses a direction.

    Newton's steps bring the smallest singular value to zero inside the limits, from the posture
    and from some around it. What they find is singular for certain, and seldom is another nearer;
    None where they find none.

    Args:
        chain: The arm.
        q: Where to start (dof,), rad or m; joints outside the limits are put onto them first.
        frame: Name of a link; the tip if None.
        offset_m: A point (3,) in that link's coordinates, metres; its origin if None.
        turning: Whether a posture counts as well in which the link loses a way to turn while the
            point stays.

    Raises:
        BadValueError: ``q`` or ``offset_m`` has a wrong shape or is not finite.
        UnknownNameError: No link is named ``frame``.
    """
    start = chain.clip(finite_vector(q, chain.dof, "q"))
    starts = _start_postures(chain, start)
    measures = _singularity_measures(chain, frame, offset_m, turning)
    ends = np.vstack([np.zeros((0, chain.dof)), *(_find_zeros(chain, starts, m) for m in measures)])
    if not len(ends):
        return None
    apart = np.linalg.norm(ends - start, axis=1)
    end = ends[int(np.argmin(apart))]
    joint = chain.names[int(np.argmax(np.abs(end - start)))]
    return Singularity(end, float(apart.min()), joint)


def _singularity_measures(
    chain: Chain, frame: str | None, offset_m: ArrayLike | None, turning: bool
) -> list[Measure]:
    moves, turns = _count_freedoms(chain, frame, offset_m)
    measures: list[Measure] = []
    if moves:
        measures.append(
            lambda q: _linear_singular_values(chain.jacobian(q, frame, offset_m), moves)[..., -1]
        )
    if turning and turns:
        measures.append(
            lambda q: _angular_singular_values(chain.jacobian(q, frame, offset_m), moves, turns)[
                ..., -1
            ]
        )
    return measures


def _start_postures(chain: Chain, q: Vector) -> Matrix:
    """Return where walks begin (2 dof + 1, dof): at q, and with one joint turned either way."""
    aside = _START_OFFSET_RAD * np.eye(chain.dof)
    starts: Matrix = chain.clip(np.vstack([q[None], q + aside, q - aside]))
    return starts


def _find_zeros(chain: Chain, q: Matrix, measure: Measure) -> Matrix:
    """Return the joints (n, dof) that walks from joints (m, dof) end at with a measure of zero."""
    values = measure(q)
    zero, ends = _ZERO * np.minimum(values, 1.0), [q[:0]]
    for _ in range(_STEPS):
        done = values <= zero
        ends.append(q[done])
        q, values, zero = q[~done], values[~done], zero[~done]
        if not len(q):
            break
        there, lower = _newton_step(chain, q, values, measure)
        falls = lower < values
        q, values, zero = there[falls], lower[falls], zero[falls]
    return np.vstack(ends)


def _newton_step(
    chain: Chain, q: Matrix, values: Vector, measure: Measure
) -> tuple[Matrix, Vector]:
    """Take Newton's step, or its half, quarter, … that lowers the measure most."""
    slope = _measure_gradient(chain, q, measure)
    size2 = np.maximum(np.sum(slope * slope, axis=1), _MIN_DERIVATIVE)
    step = -(values / size2)[:, None] * slope
    longest = np.maximum(np.abs(step).max(axis=1), _MAX_STEP_RAD)
    shares = 0.5 ** np.arange(_HALVINGS)
    tried = q[:, None] + shares[None, :, None] * (_MAX_STEP_RAD / longest * step.T).T[:, None]
    inside = chain.clip(tried.reshape(-1, chain.dof))
    left = measure(inside).reshape(len(q), _HALVINGS)
    tried = inside.reshape(tried.shape)
    best = np.argmin(left, axis=1)
    rows = np.arange(len(q))
    return tried[rows, best], left[rows, best]


def _measure_gradient(chain: Chain, q: Matrix, measure: Measure) -> Matrix:
    """Return the derivative (n, dof); 0 for joints at a limit that it would carry further."""
    aside = _DIFFERENCE_RAD * np.eye(chain.dof)
    beside = np.concatenate([q[:, None] + aside, q[:, None] - aside], axis=1)
    plus, minus = np.split(measure(beside.reshape(-1, chain.dof)).reshape(len(q), -1), 2, axis=1)
    slope = (plus - minus) / (2.0 * _DIFFERENCE_RAD)
    held = ((q <= chain.lower_rad) & (slope > 0.0)) | ((q >= chain.upper_rad) & (slope < 0.0))
    return np.where(held, 0.0, slope)


def _linear_singular_values(J: Matrix, count: int) -> Vector:
    """Return the largest singular values (count,) or (n, count) of the linear rows."""
    return _singular_values(J[..., :3, :])[..., :count]


def _angular_singular_values(J: Matrix, moves: int, count: int) -> Vector:
    """Return those of the angular rows for joints that leave the point where it is."""
    _, _, Vt = np.linalg.svd(J[..., :3, :], full_matrices=True)
    still = np.swapaxes(Vt[..., moves:, :], -1, -2)
    if not count:
        return np.zeros((*J.shape[:-2], 0))
    return _singular_values(J[..., 3:, :] @ still)[..., :count]


def ordinary_postures(dof: int) -> Matrix:
    """Return a few postures (n, dof) that no arm is singular in: multiples of irrational turns."""
    turns = (0.5 + np.outer(np.arange(1, _SAMPLES + 1), _IRRATIONAL)) % 1.0
    return np.resize(2.0 * math.pi * turns, (_SAMPLES, dof))


def _count_freedoms(chain: Chain, frame: str | None, offset_m: ArrayLike | None) -> tuple[int, int]:
    """Return in how many directions the arm moves the point, and then still turns its link."""
    J = chain.jacobian(ordinary_postures(chain.dof), frame, offset_m)
    moves = _numerical_rank(_singular_values(J[:, :3]))
    _, _, Vt = np.linalg.svd(J[:, :3], full_matrices=True)
    turned = J[:, 3:] @ np.swapaxes(Vt[:, moves:, :], 1, 2)
    return moves, _numerical_rank(_singular_values(turned)) if moves < chain.dof else 0


def _numerical_rank(values: Matrix) -> int:
    """Return how many singular values (looks, k) are not zero in every look."""
    return int((values > _RANK * max(values.max(initial=0.0), 1e-300)).sum(axis=1).max(initial=0))


def _singular_values(matrices: Matrix) -> Matrix:
    values: Matrix = np.linalg.svd(matrices, compute_uv=False).astype(np.float64, copy=False)
    return values
