"""Small symmetric systems on the desk, solved in place by Cholesky's factorisation."""

from __future__ import annotations

import math

from ikservo.ik.kernel.compiling import inner
from ikservo.kinematics.se3 import Matrix

__all__ = ["factor", "substitute"]


@inner
def factor(desk: Matrix, A: int, n: int, damping: float) -> bool:
    """Replace the lower triangle of A + damping I by its factor L; False if not positive.

    ``A`` is the first of the n rows on the desk where the matrix stands.
    """
    for j in range(n):
        d = desk[A + j, j] + damping
        for k in range(j):
            d -= desk[A + j, k] * desk[A + j, k]
        if not d > 0.0:
            return False
        d = math.sqrt(d)
        desk[A + j, j] = d
        for i in range(j + 1, n):
            s = desk[A + i, j]
            for k in range(j):
                s -= desk[A + i, k] * desk[A + j, k]
            desk[A + i, j] = s / d
    return True


@inner
def substitute(desk: Matrix, L: int, n: int, y: int) -> None:
    """Replace row y by the solution of L Lᵀ x = y."""
    for i in range(n):
        s = desk[y, i]
        for k in range(i):
            s -= desk[L + i, k] * desk[y, k]
        desk[y, i] = s / desk[L + i, i]
    for i in range(n - 1, -1, -1):
        s = desk[y, i]
        for k in range(i + 1, n):
            s -= desk[L + k, i] * desk[y, k]
        desk[y, i] = s / desk[L + i, i]
