"""Which way is down for the free joints: Gauss-Newton and Newton steps (lecture L9)."""

from __future__ import annotations

from ikservo.ik.kernel.bending import bend
from ikservo.ik.kernel.compiling import inlined, inner
from ikservo.ik.kernel.desk import ERROR, FREE, NORMAL, PULL, RHS, STEP, G, H, Y
from ikservo.ik.kernel.linear import factor, substitute
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["least_norm", "least_squares", "newton"]

# Rounding errors of a singular matrix stay below _FLOOR of its size.
_FLOOR, _FIRST_DAMPING, _TINY = 1e-13, 1e-3, 1e-300


@inlined
def _left_over(rows: int, n: int, desk: Matrix) -> None:
    """Fill Y with the error that remains after the steps of the joints that are not free."""
    for r in range(rows):
        s = desk[ERROR, r]
        for j in range(n):
            if desk[FREE, j] == 0.0:
                s -= desk[G + r, j] * desk[STEP, j]
        desk[Y, r] = s


@inner
def least_norm(rows: int, damping: float, n: int, desk: Matrix) -> None:
    """Solve in the space of the error: step = Gᵀ (G Gᵀ + damping I)⁻¹ y."""
    _left_over(rows, n, desk)
    trace = 0.0
    for a in range(rows):
        for b in range(a + 1):
            s = 0.0
            for j in range(n):
                s += desk[G + a, j] * desk[G + b, j] * desk[FREE, j]
            desk[NORMAL + a, b] = s
        trace += desk[NORMAL + a, a]
    if not factor(desk, NORMAL, rows, damping + _FLOOR * trace + _TINY):
        return
    substitute(desk, NORMAL, rows, Y)
    for j in range(n):
        if desk[FREE, j] == 1.0:
            s = 0.0
            for r in range(rows):
                s += desk[G + r, j] * desk[Y, r]
            desk[STEP, j] = s


@inlined
def least_squares(rows: int, damping: float, n: int, desk: Matrix) -> None:
    """Solve in the space of the joints: step = (Gᵀ G + damping I)⁻¹ Gᵀ y."""
    trace = _squared(rows, n, desk)
    _aim(n, desk)
    _solve(damping + _FLOOR * trace + _TINY, n, desk)


@inlined
def _squared(rows: int, n: int, desk: Matrix) -> float:
    """Fill the lower triangle of H with Gᵀ G; return its trace. A sixth row is there or is 0."""
    trace = 0.0
    for a in range(n):
        g0, g1, g2 = desk[G, a], desk[G + 1, a], desk[G + 2, a]
        g3, g4, g5 = desk[G + 3, a], desk[G + 4, a], desk[G + 5, a]
        for b in range(a + 1):
            s = g0 * desk[G, b] + g1 * desk[G + 1, b] + g2 * desk[G + 2, b]
            if rows > 3:
                s += g3 * desk[G + 3, b] + g4 * desk[G + 4, b] + g5 * desk[G + 5, b]
            desk[H + a, b] = s
        trace += desk[H + a, a]
    return trace


@inner
def newton(question: Vector, kind: int, weight: float, n: int, desk: Matrix) -> float:
    """Solve with the second derivative, damped until every direction curves upwards.

    Returns the damping as a share of the largest curvature.
    """
    size, share = bend(question, kind, weight, n, desk), _FLOOR
    _mirror(n, desk)
    _aim(n, desk)
    for _ in range(20):
        if _solve(share * size + _TINY, n, desk):
            break
        share = max(4.0 * share, _FIRST_DAMPING)
        _mirror(n, desk)
    return share


@inlined
def _mirror(n: int, desk: Matrix) -> None:
    """Write H's lower triangle, in which it is factored, anew from what ``bend`` has left."""
    for j in range(n):
        for i in range(j):
            desk[H + j, i] = desk[H + i, j]
        desk[H + j, j] = desk[H + j, n]


@inlined
def _aim(n: int, desk: Matrix) -> None:
    """Fill RHS with the pull that remains after the steps of the joints that are not free."""
    for a in range(n):
        desk[RHS, a] = desk[PULL, a] * desk[FREE, a]
    for b in range(n):
        if desk[FREE, b] == 0.0 and desk[STEP, b] != 0.0:
            for a in range(n):
                change = desk[H + max(a, b), min(a, b)] * desk[STEP, b]
                desk[RHS, a] -= change * desk[FREE, a]


@inner
def _solve(damping: float, n: int, desk: Matrix) -> bool:
    """Fill STEP of the free joints with (H + damping I)⁻¹ RHS; False if that is not positive."""
    _take_out_held(n, desk)
    if not factor(desk, H, n, damping):
        return False
    substitute(desk, H, n, RHS)
    for j in range(n):
        if desk[FREE, j] == 1.0:
            desk[STEP, j] = desk[RHS, j]
    return True


@inlined
def _take_out_held(n: int, desk: Matrix) -> None:
    """Make H the identity for the joints that are not free."""
    for j in range(n):
        if desk[FREE, j] == 0.0:
            for i in range(j):
                desk[H + j, i] = 0.0
            for i in range(j + 1, n):
                desk[H + i, j] = 0.0
            desk[H + j, j] = 1.0
