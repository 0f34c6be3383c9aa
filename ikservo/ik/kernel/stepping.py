"""One step downhill inside the limits: Gauss-Newton or Newton with an active set (lecture L9).

A joint that the step would carry past its limit is set on it, and the others are solved again
for what is left, until none leaves.
"""

from __future__ import annotations

from ikservo.ik.kernel.bending import bend
from ikservo.ik.kernel.compiling import inner
from ikservo.ik.kernel.desk import ERROR, FREE, HIGH, LOW, NORMAL, PULL, RHS, STEP, G, H, Q, Y
from ikservo.ik.kernel.linear import factor, substitute
from ikservo.ik.kernel.looking import rows_of
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["curves_down", "downhill", "release"]

# Rounding errors of a singular matrix stay below _FLOOR of its size; a curvature beyond -_FLAT of
# it is a way down and no flat valley.
_FLOOR, _FLAT, _FIRST_DAMPING, _TINY = 1e-13, 1e-7, 1e-3, 1e-300


@inner
def release(n: int, desk: Matrix) -> float:
    """Free the joints that no limit holds; return the steepest pull among them."""
    steepest = 0.0
    for j in range(n):
        pull, q = desk[PULL, j], desk[Q, j]
        held = (q <= desk[LOW, j] and pull < 0.0) or (q >= desk[HIGH, j] and pull > 0.0)
        desk[FREE, j] = 0.0 if held else 1.0
        desk[STEP, j] = 0.0
        if not held:
            steepest = max(steepest, abs(pull))
    return steepest


@inner
def downhill(
    question: Vector,
    kind: int,
    weight: float,
    newton: bool,
    damping: float,
    radius: float,
    n: int,
    desk: Matrix,
) -> float:
    """Fill STEP and return its largest entry; ``look`` and ``release`` come before.

    The step of the free joints is scaled to ``radius`` as a whole (lecture L7), so that its
    direction stays.
    """
    rows = rows_of(kind, weight)
    for _ in range(n + 1):
        if newton:
            _newton(question, kind, weight, n, desk)
        elif rows < n:
            _least_norm(rows, damping, n, desk)
        else:
            _least_squares(rows, damping, n, desk)
        if _all_inside(radius, n, desk):
            break
    longest = 0.0
    for j in range(n):
        longest = max(longest, abs(desk[STEP, j]))
    return longest


@inner
def curves_down(question: Vector, kind: int, weight: float, n: int, desk: Matrix) -> bool:
    """Return whether the free joints stand on a saddle or a top: some way leads down."""
    return _newton(question, kind, weight, n, desk) > _FLAT


@inner
def _all_inside(radius: float, n: int, desk: Matrix) -> bool:
    """Scale the free joints' step; set those that leave their limits on them and return False."""
    longest = 0.0
    for j in range(n):
        if desk[FREE, j] == 1.0:
            longest = max(longest, abs(desk[STEP, j]))
    scale = radius / longest if longest > radius else 1.0
    inside = True
    for j in range(n):
        if desk[FREE, j] == 1.0:
            desk[STEP, j] *= scale
            there = desk[Q, j] + desk[STEP, j]
            if there < desk[LOW, j] or there > desk[HIGH, j]:
                end = desk[LOW, j] if there < desk[LOW, j] else desk[HIGH, j]
                desk[STEP, j] = end - desk[Q, j]
                desk[FREE, j] = 0.0
                inside = False
    return inside


@inner
def _left_over(rows: int, n: int, desk: Matrix) -> None:
    """Fill Y with the error that remains after the steps of the joints that are not free."""
    for r in range(rows):
        s = desk[ERROR, r]
        for j in range(n):
            if desk[FREE, j] == 0.0:
                s -= desk[G + r, j] * desk[STEP, j]
        desk[Y, r] = s


@inner
def _least_norm(rows: int, damping: float, n: int, desk: Matrix) -> None:
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


@inner
def _least_squares(rows: int, damping: float, n: int, desk: Matrix) -> None:
    """Solve in the space of the joints: step = (Gᵀ G + damping I)⁻¹ Gᵀ y."""
    _left_over(rows, n, desk)
    trace = 0.0
    for a in range(n):
        s = 0.0
        for r in range(rows):
            s += desk[G + r, a] * desk[Y, r]
        desk[RHS, a] = s * desk[FREE, a]
        for b in range(a + 1):
            s = 0.0
            for r in range(rows):
                s += desk[G + r, a] * desk[G + r, b]
            desk[H + a, b] = s
        trace += desk[H + a, a]
    _take_out_held(n, desk)
    if factor(desk, H, n, damping + _FLOOR * trace + _TINY):
        _solve_for_step(n, desk)


@inner
def _newton(question: Vector, kind: int, weight: float, n: int, desk: Matrix) -> float:
    """Solve with the second derivative, damped until every direction curves upwards.

    Returns the damping as a share of the largest curvature.
    """
    share = _FLOOR
    for _ in range(20):
        size = bend(question, kind, weight, n, desk)
        for a in range(n):
            s = desk[PULL, a]
            for b in range(n):
                if desk[FREE, b] == 0.0:
                    s -= desk[H + max(a, b), min(a, b)] * desk[STEP, b]
            desk[RHS, a] = s * desk[FREE, a]
        _take_out_held(n, desk)
        if factor(desk, H, n, share * size + _TINY):
            _solve_for_step(n, desk)
            break
        share = max(4.0 * share, _FIRST_DAMPING)
    return share


@inner
def _take_out_held(n: int, desk: Matrix) -> None:
    """Make H the identity for the joints that are not free."""
    for j in range(n):
        if desk[FREE, j] == 0.0:
            for i in range(j):
                desk[H + j, i] = 0.0
            for i in range(j + 1, n):
                desk[H + i, j] = 0.0
            desk[H + j, j] = 1.0


@inner
def _solve_for_step(n: int, desk: Matrix) -> None:
    substitute(desk, H, n, RHS)
    for j in range(n):
        if desk[FREE, j] == 1.0:
            desk[STEP, j] = desk[RHS, j]
