"""Joint vectors that fill the limits evenly, the same ones every time, and where the tip is."""

from __future__ import annotations

import math

import numpy as np

from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Matrix

__all__ = ["joint_samples", "tips"]


def joint_samples(chain: Chain, count: int) -> Matrix:
    """Return ``count`` joint vectors (count, dof) inside the limits; full turns where free.

    An additive recurrence: point k is the fraction of ``k / g^j`` in joint j, with the root g of
    ``g^(dof+1) = g + 1``, the generalised golden ratio (Roberts 2018), which leaves no clusters.
    """
    steps = _golden_ratio(chain.dof) ** -np.arange(1.0, chain.dof + 1)
    evenly = (0.5 + np.outer(np.arange(1.0, count + 1), steps)) % 1.0
    low = np.maximum(chain.lower_rad, -math.pi)
    high = np.minimum(chain.upper_rad, math.pi)
    return chain.clip(low + (high - low) * evenly)


def tips(chain: Chain, q: Matrix) -> Matrix:
    """Return where the tip is (n, 3), metres, at each of the joint vectors (n, dof)."""
    return chain.forward(q)[:, :3, 3]


def _golden_ratio(dimensions: int) -> float:
    ratio = 2.0
    for _ in range(64):
        ratio = (1.0 + ratio) ** (1.0 / (dimensions + 1))
    return ratio
