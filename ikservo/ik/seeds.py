"""Starting points of a search beside the caller's: a fixed table that fills the limits."""

from __future__ import annotations

import math

import numpy as np

from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["seeds"]


def seeds(chain: Chain, count: int) -> Matrix:
    """Return (count, dof) joint vectors inside the limits: the middle, then an even filling.

    The sequence is the same every time: the same question gets the same answer.

    Source: M. Roberts, The unreasonable effectiveness of quasirandom sequences, 2018: point i is
    ``frac(½ + i / φ^j)`` in dimension j, where ``φ^(dof + 1) = φ + 1``.
    """
    low, high = np.maximum(chain.lower_rad, -math.pi), np.minimum(chain.upper_rad, math.pi)
    outside = low > high  # a range that begins beyond a half turn
    low[outside], high[outside] = chain.lower_rad[outside], chain.upper_rad[outside]
    points = chain.clip(low + (high - low) * _evenly(count, chain.dof))
    points[:1] = chain.middle()
    return points


def _evenly(count: int, dimensions: int) -> Matrix:
    steps: Vector = _root(dimensions) ** -np.arange(1.0, dimensions + 1)
    return (0.5 + np.outer(np.arange(count), steps)) % 1.0


def _root(dimensions: int) -> float:
    """Return φ: the golden ratio for one dimension, and its like for more."""
    root = 2.0
    for _ in range(64):
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    return root
