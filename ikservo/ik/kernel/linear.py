"""Small symmetric systems on the desk, solved in place by a factorisation without square roots."""

from __future__ import annotations

from ikservo.ik.kernel.compiling import inlined
from ikservo.kinematics.se3 import Matrix

__all__ = ["factor", "substitute"]


@inlined
def factor(desk: Matrix, A: int, n: int, damping: float) -> bool:
    """Replace the lower triangle of A + damping I = L D Lᵀ by L D; False if not positive.

    ``A`` is the first of the n rows on the desk where the matrix stands. The diagonal takes D's
    reciprocals. Quotients and roots are what a small system waits for: here it is one a row.
    """
    for j in range(n):
        d = desk[A + j, j] + damping
        for k in range(j):
            d -= desk[A + j, k] * (desk[A + j, k] * desk[A + k, k])
        if not d > 0.0:
            return False
        desk[A + j, j] = 1.0 / d
        for i in range(j + 1, n):
            s = desk[A + i, j]
            for k in range(j):
                s -= desk[A + i, k] * (desk[A + j, k] * desk[A + k, k])
            desk[A + i, j] = s
    return True


@inlined
def substitute(desk: Matrix, L: int, n: int, y: int) -> None:
    """Replace row y by the solution of L D Lᵀ x = y."""
    for i in range(n):
        s = desk[y, i]
        for k in range(i):
            s -= desk[L + i, k] * desk[y, k]
        desk[y, i] = s * desk[L + i, i]
    for i in range(n - 2, -1, -1):
        s = 0.0
        for k in range(i + 1, n):
            s += desk[L + k, i] * desk[y, k]
        desk[y, i] -= s * desk[L + i, i]
