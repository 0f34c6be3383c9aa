"""Starting points of a search: the caller's, then a fixed sequence that fills the limits."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Vector

__all__ = ["seeds"]

_PRIMES = (2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37)


def seeds(chain: Chain, q0: Vector, count: int) -> Iterator[Vector]:
    """Yield ``count`` joint vectors (dof,) inside the limits: q0, the middle, a Halton sequence.

    The sequence is the same every time: the same question gets the same answer.
    """
    low = np.maximum(chain.lower_rad, -math.pi)
    high = np.minimum(chain.upper_rad, math.pi)
    yield chain.clip(q0)
    if count > 1:
        yield chain.middle()
    for index in range(1, count - 1):
        yield chain.clip(low + (high - low) * _halton(index, chain.dof))


def _halton(index: int, dimensions: int) -> Vector:
    """Return point ``index`` >= 1 of the Halton sequence in the unit cube."""
    bases = (_PRIMES[i % len(_PRIMES)] for i in range(dimensions))
    return np.array([_radical_inverse(index + 7 * (i // 12), b) for i, b in enumerate(bases)])


def _radical_inverse(index: int, base: int) -> float:
    """Mirror the digits of ``index`` at the point: 6 = 110₂ becomes 0.011₂."""
    value, digit = 0.0, 1.0
    while index:
        digit /= base
        value += digit * (index % base)
        index //= base
    return value
