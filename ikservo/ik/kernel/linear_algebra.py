"""Small linear algebra of the kernel: LDL factorisation, least-norm and Newton steps, Hessian."""

from __future__ import annotations

from ikservo.ik.kernel.jit import jit, jit_inline
from ikservo.ik.kernel.layout import (
    DIRECTION,
    FREE,
    HESSIAN,
    J_WEIGHTED,
    NEG_GRAD,
    NORMAL,
    POSITION_ONLY,
    RESIDUAL,
    RHS,
    RHS_ERROR,
    STEP,
    TOOL_POSE,
    WANTED_ROTATION,
    J,
)
from ikservo.kinematics.arrays import Matrix, Vector

__all__ = ["hessian", "ldl_factor", "ldl_solve", "least_norm", "least_squares", "newton_step"]


@jit_inline
def ldl_factor(desk: Matrix, A: int, n: int, damping: float) -> bool:
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


@jit_inline
def ldl_solve(desk: Matrix, L: int, n: int, y: int) -> None:
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


@jit
def hessian(question: Vector, kind: int, weight: float, n: int, desk: Matrix) -> float:
    """Fill H (n, n) above its diagonal, and that into column n; return the largest entry there.

    Turning joint i swings the column of every joint j behind it, d²p/dq_i dq_j = w_i x J_j, and
    likewise every axis r of the tool, d²r/dq_i dq_j = w_i x (w_j x r). With M = Σ r_k d_kᵀ over
    the axes that are compared, the turn's part is ``w_i · (tr(M) - M) w_j``.
    """
    share, trace, size = 0.0, 0.0, 0.0
    if kind != POSITION_ONLY and weight > 0.0:
        share = weight * weight * (1.0 if kind == DIRECTION else 0.5)
        trace = _residual_overlap(question, kind, desk)
    e0, e1, e2 = desk[RESIDUAL, 0], desk[RESIDUAL, 1], desk[RESIDUAL, 2]
    for j in range(n):
        a0, a1, a2 = desk[J, j], desk[J + 1, j], desk[J + 2, j]
        w0, w1, w2 = desk[J + 3, j], desk[J + 4, j], desk[J + 5, j]
        # (w_i x J_j) · e = w_i · (J_j x e)
        m0, m1, m2 = a2 * e1 - a1 * e2, a0 * e2 - a2 * e0, a1 * e0 - a0 * e1
        if share > 0.0:
            m0 += share * (trace * w0 - _hessian_row(desk, 0, w0, w1, w2))
            m1 += share * (trace * w1 - _hessian_row(desk, 1, w0, w1, w2))
            m2 += share * (trace * w2 - _hessian_row(desk, 2, w0, w1, w2))
        for i in range(j + 1):
            turned = desk[J + 3, i] * m0 + desk[J + 4, i] * m1 + desk[J + 5, i] * m2
            desk[HESSIAN + i, j] = (
                desk[J, i] * a0 + desk[J + 1, i] * a1 + desk[J + 2, i] * a2 + turned
            )
        desk[HESSIAN + j, n] = desk[HESSIAN + j, j]
        size = max(size, abs(desk[HESSIAN + j, n]))
    return size


@jit_inline
def _residual_overlap(question: Vector, kind: int, desk: Matrix) -> float:
    """Fill M = Σ r_k d_kᵀ (3, 3) into NORMAL; return its trace."""
    first = 2 if kind == DIRECTION else 0
    for a in range(3):
        for b in range(3):
            s = 0.0
            for k in range(first, 3):
                s += desk[TOOL_POSE, 3 * a + k] * question[WANTED_ROTATION + 3 * b + k]
            desk[NORMAL + a, b] = s
    return desk[NORMAL, 0] + desk[NORMAL + 1, 1] + desk[NORMAL + 2, 2]


@jit_inline
def _hessian_row(desk: Matrix, a: int, w0: float, w1: float, w2: float) -> float:
    return desk[NORMAL + a, 0] * w0 + desk[NORMAL + a, 1] * w1 + desk[NORMAL + a, 2] * w2


# Rounding errors of a singular matrix stay below _FLOOR of its size.
_FLOOR, _FIRST_DAMPING, _TINY = 1e-13, 1e-3, 1e-300


@jit_inline
def _remaining_error(rows: int, n: int, desk: Matrix) -> None:
    """Fill Y with the error that remains after the steps of the joints that are not free."""
    for r in range(rows):
        s = desk[RESIDUAL, r]
        for j in range(n):
            if desk[FREE, j] == 0.0:
                s -= desk[J_WEIGHTED + r, j] * desk[STEP, j]
        desk[RHS_ERROR, r] = s


@jit
def least_norm(rows: int, damping: float, n: int, desk: Matrix) -> None:
    """Solve in the space of the error: step = Gᵀ (G Gᵀ + damping I)⁻¹ y."""
    _remaining_error(rows, n, desk)
    trace = 0.0
    for a in range(rows):
        for b in range(a + 1):
            s = 0.0
            for j in range(n):
                s += desk[J_WEIGHTED + a, j] * desk[J_WEIGHTED + b, j] * desk[FREE, j]
            desk[NORMAL + a, b] = s
        trace += desk[NORMAL + a, a]
    if not ldl_factor(desk, NORMAL, rows, damping + _FLOOR * trace + _TINY):
        return
    ldl_solve(desk, NORMAL, rows, RHS_ERROR)
    for j in range(n):
        if desk[FREE, j] == 1.0:
            s = 0.0
            for r in range(rows):
                s += desk[J_WEIGHTED + r, j] * desk[RHS_ERROR, r]
            desk[STEP, j] = s


@jit_inline
def least_squares(rows: int, damping: float, n: int, desk: Matrix) -> None:
    """Solve in the space of the joints: step = (Gᵀ G + damping I)⁻¹ Gᵀ y."""
    trace = _normal_matrix(rows, n, desk)
    _fill_rhs(n, desk)
    _solve_free_joints(damping + _FLOOR * trace + _TINY, n, desk)


@jit_inline
def _normal_matrix(rows: int, n: int, desk: Matrix) -> float:
    """Fill the lower triangle of H with Gᵀ G; return its trace. A sixth row is there or is 0."""
    trace = 0.0
    for a in range(n):
        g0, g1, g2 = desk[J_WEIGHTED, a], desk[J_WEIGHTED + 1, a], desk[J_WEIGHTED + 2, a]
        g3, g4, g5 = desk[J_WEIGHTED + 3, a], desk[J_WEIGHTED + 4, a], desk[J_WEIGHTED + 5, a]
        for b in range(a + 1):
            s = (
                g0 * desk[J_WEIGHTED, b]
                + g1 * desk[J_WEIGHTED + 1, b]
                + g2 * desk[J_WEIGHTED + 2, b]
            )
            if rows > 3:
                s += (
                    g3 * desk[J_WEIGHTED + 3, b]
                    + g4 * desk[J_WEIGHTED + 4, b]
                    + g5 * desk[J_WEIGHTED + 5, b]
                )
            desk[HESSIAN + a, b] = s
        trace += desk[HESSIAN + a, a]
    return trace


@jit
def newton_step(question: Vector, kind: int, weight: float, n: int, desk: Matrix) -> float:
    """Solve with the second derivative, damped until every direction curves upwards.

    Returns the damping as a share of the largest curvature.
    """
    size, share = hessian(question, kind, weight, n, desk), _FLOOR
    _mirror_hessian(n, desk)
    _fill_rhs(n, desk)
    for _ in range(20):
        if _solve_free_joints(share * size + _TINY, n, desk):
            break
        share = max(4.0 * share, _FIRST_DAMPING)
        _mirror_hessian(n, desk)
    return share


@jit_inline
def _mirror_hessian(n: int, desk: Matrix) -> None:
    """Write H's lower triangle, in which it is factored, anew from what ``bend`` has left."""
    for j in range(n):
        for i in range(j):
            desk[HESSIAN + j, i] = desk[HESSIAN + i, j]
        desk[HESSIAN + j, j] = desk[HESSIAN + j, n]


@jit_inline
def _fill_rhs(n: int, desk: Matrix) -> None:
    """Fill RHS with the pull that remains after the steps of the joints that are not free."""
    for a in range(n):
        desk[RHS, a] = desk[NEG_GRAD, a] * desk[FREE, a]
    for b in range(n):
        if desk[FREE, b] == 0.0 and desk[STEP, b] != 0.0:
            for a in range(n):
                change = desk[HESSIAN + max(a, b), min(a, b)] * desk[STEP, b]
                desk[RHS, a] -= change * desk[FREE, a]


@jit
def _solve_free_joints(damping: float, n: int, desk: Matrix) -> bool:
    """Fill STEP of the free joints with (H + damping I)⁻¹ RHS; False if that is not positive."""
    _remove_fixed_joints(n, desk)
    if not ldl_factor(desk, HESSIAN, n, damping):
        return False
    ldl_solve(desk, HESSIAN, n, RHS)
    for j in range(n):
        if desk[FREE, j] == 1.0:
            desk[STEP, j] = desk[RHS, j]
    return True


@jit_inline
def _remove_fixed_joints(n: int, desk: Matrix) -> None:
    """Make H the identity for the joints that are not free."""
    for j in range(n):
        if desk[FREE, j] == 0.0:
            for i in range(j):
                desk[HESSIAN + j, i] = 0.0
            for i in range(j + 1, n):
                desk[HESSIAN + i, j] = 0.0
            desk[HESSIAN + j, j] = 1.0
