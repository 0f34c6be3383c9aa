"""Starting points of a search beside the caller's: a fixed table that fills the limits."""

from __future__ import annotations

import math

import numpy as np

from ikservo.kinematics import Chain, JointKind
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["seeds"]


def seeds(chain: Chain, count: int) -> Matrix:
    """Return (count, dof) joint vectors inside the limits: the middle, then an even filling.

    The sequence is the same every time: the same question gets the same answer.

    Source: M. Roberts, The unreasonable effectiveness of quasirandom sequences, 2018: point i is
    ``frac(½ + i / φ^j)`` in dimension j, where ``φ^(dof + 1) = φ + 1``.
    """
    low, high = _worth_a_look(chain)
    points = chain.clip(low + (high - low) * _evenly(count, chain.dof))
    points[:1] = chain.middle()
    return points


def _worth_a_look(chain: Chain) -> tuple[Vector, Vector]:
    """Return the limits (dof,) each, of more than a turn the one that is nearest to zero."""
    low, high = chain.lower_rad.copy(), chain.upper_rad.copy()
    wide = (high - low > math.tau) & [kind is not JointKind.PRISMATIC for kind in chain.kinds]
    wide |= ~np.isfinite(low) | ~np.isfinite(high)
    first = np.clip(-math.pi, low[wide], high[wide] - math.tau)
    low[wide], high[wide] = first, first + math.tau
    return low, high


def _evenly(count: int, dimensions: int) -> Matrix:
    steps: Vector = _root(dimensions) ** -np.arange(1.0, dimensions + 1)
    return (0.5 + np.outer(np.arange(count), steps)) % 1.0


def _root(dimensions: int) -> float:
    """Return φ: the golden ratio for one dimension, and its like for more."""
    root = 2.0
    for _ in range(64):
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    return root
