"""Small linear algebra of the kernel: LDL factorisation, least-norm and Newton steps, Hessian."""

from __future__ import annotations

from ikservo.kernels.layout import (
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


def ldl_factor(work: Matrix, A: int, n: int, damping: float) -> bool:
    """Replace the lower triangle of A + damping I = L D Lᵀ by L D; False if not positive definite.

    ``A`` is the number of the matrix's first row in the work array; n rows follow from there. The
    diagonal takes the reciprocals of D, because divisions and roots dominate the time of a small
    system: one division per row.
    """
    for j in range(n):
        d = work[A + j, j] + damping
        for k in range(j):
            d -= work[A + j, k] * (work[A + j, k] * work[A + k, k])
        if not d > 0.0:
            return False
        work[A + j, j] = 1.0 / d
        for i in range(j + 1, n):
            s = work[A + i, j]
            for k in range(j):
                s -= work[A + i, k] * (work[A + j, k] * work[A + k, k])
            work[A + i, j] = s
    return True


def ldl_solve(work: Matrix, L: int, n: int, y: int) -> None:
    """Replace row y by the solution of L D Lᵀ x = y."""
    for i in range(n):
        s = work[y, i]
        for k in range(i):
            s -= work[L + i, k] * work[y, k]
        work[y, i] = s * work[L + i, i]
    for i in range(n - 2, -1, -1):
        s = 0.0
        for k in range(i + 1, n):
            s += work[L + k, i] * work[y, k]
        work[y, i] -= s * work[L + i, i]


def hessian(problem: Vector, kind: int, weight: float, n: int, work: Matrix) -> float:
    """Fill H (n, n) above its diagonal, and the diagonal into column n; return its largest entry.

    Joint i rotates the column of every later joint j, d²p/dq_i dq_j = w_i x J_j, and also every
    axis r of the tool, d²r/dq_i dq_j = w_i x (w_j x r). With M = Σ r_k d_kᵀ over the axes that are
    compared, the orientation's term is ``w_i · (tr(M) - M) w_j``.
    """
    coefficient, trace, size = 0.0, 0.0, 0.0
    if kind != POSITION_ONLY and weight > 0.0:
        coefficient = weight * weight * (1.0 if kind == DIRECTION else 0.5)
        trace = _residual_overlap(problem, kind, work)
    e0, e1, e2 = work[RESIDUAL, 0], work[RESIDUAL, 1], work[RESIDUAL, 2]
    for j in range(n):
        a0, a1, a2 = work[J, j], work[J + 1, j], work[J + 2, j]
        w0, w1, w2 = work[J + 3, j], work[J + 4, j], work[J + 5, j]
        # (w_i x J_j) · e = w_i · (J_j x e)
        m0, m1, m2 = a2 * e1 - a1 * e2, a0 * e2 - a2 * e0, a1 * e0 - a0 * e1
        if coefficient > 0.0:
            m0 += coefficient * (trace * w0 - _hessian_row(work, 0, w0, w1, w2))
            m1 += coefficient * (trace * w1 - _hessian_row(work, 1, w0, w1, w2))
            m2 += coefficient * (trace * w2 - _hessian_row(work, 2, w0, w1, w2))
        for i in range(j + 1):
            curved = work[J + 3, i] * m0 + work[J + 4, i] * m1 + work[J + 5, i] * m2
            work[HESSIAN + i, j] = (
                work[J, i] * a0 + work[J + 1, i] * a1 + work[J + 2, i] * a2 + curved
            )
        work[HESSIAN + j, n] = work[HESSIAN + j, j]
        size = max(size, abs(work[HESSIAN + j, n]))
    return size


def _residual_overlap(problem: Vector, kind: int, work: Matrix) -> float:
    """Fill M = Σ r_k d_kᵀ (3, 3) into NORMAL; return its trace."""
    first = 2 if kind == DIRECTION else 0
    for a in range(3):
        for b in range(3):
            s = 0.0
            for k in range(first, 3):
                s += work[TOOL_POSE, 3 * a + k] * problem[WANTED_ROTATION + 3 * b + k]
            work[NORMAL + a, b] = s
    return work[NORMAL, 0] + work[NORMAL + 1, 1] + work[NORMAL + 2, 2]


def _hessian_row(work: Matrix, a: int, w0: float, w1: float, w2: float) -> float:
    return work[NORMAL + a, 0] * w0 + work[NORMAL + a, 1] * w1 + work[NORMAL + a, 2] * w2


# Rounding errors of a singular matrix stay below _FLOOR of its size.
_FLOOR, _FIRST_DAMPING, _TINY = 1e-13, 1e-3, 1e-300


def _remaining_error(rows: int, n: int, work: Matrix) -> None:
    """Fill RHS_ERROR with the residual that remains after the steps of the fixed joints."""
    for r in range(rows):
        s = work[RESIDUAL, r]
        for j in range(n):
            if work[FREE, j] == 0.0:
                s -= work[J_WEIGHTED + r, j] * work[STEP, j]
        work[RHS_ERROR, r] = s


def least_norm(rows: int, damping: float, n: int, work: Matrix) -> None:
    """Solve in the space of the residual: step = Gᵀ (G Gᵀ + damping I)⁻¹ y, G the Jacobian."""
    _remaining_error(rows, n, work)
    trace = _gram_matrix(rows, n, work)
    if not ldl_factor(work, NORMAL, rows, damping + _FLOOR * trace + _TINY):
        return
    ldl_solve(work, NORMAL, rows, RHS_ERROR)
    for j in range(n):
        if work[FREE, j] == 1.0:
            s = 0.0
            for r in range(rows):
                s += work[J_WEIGHTED + r, j] * work[RHS_ERROR, r]
            work[STEP, j] = s


def _gram_matrix(rows: int, n: int, work: Matrix) -> float:
    """Fill the lower triangle of NORMAL with G Gᵀ of the free joints; return its trace."""
    # Six sums at once of the three position rows, which do not depend on each other.
    s00, s10, s11, s20, s21, s22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(n):
        g0, g1, g2 = work[J_WEIGHTED, j], work[J_WEIGHTED + 1, j], work[J_WEIGHTED + 2, j]
        free = work[FREE, j]
        s00 += g0 * g0 * free
        s10 += g1 * g0 * free
        s11 += g1 * g1 * free
        s20 += g2 * g0 * free
        s21 += g2 * g1 * free
        s22 += g2 * g2 * free
    work[NORMAL, 0] = s00
    work[NORMAL + 1, 0], work[NORMAL + 1, 1] = s10, s11
    work[NORMAL + 2, 0], work[NORMAL + 2, 1], work[NORMAL + 2, 2] = s20, s21, s22
    for a in range(3, rows):
        for b in range(a + 1):
            s = 0.0
            for j in range(n):
                s += work[J_WEIGHTED + a, j] * work[J_WEIGHTED + b, j] * work[FREE, j]
            work[NORMAL + a, b] = s
    trace = 0.0
    for a in range(rows):
        trace += work[NORMAL + a, a]
    return trace


def least_squares(rows: int, damping: float, n: int, work: Matrix) -> None:
    """Solve in the space of the joints: step = (Gᵀ G + damping I)⁻¹ Gᵀ y."""
    trace = _normal_matrix(rows, n, work)
    _fill_rhs(n, work)
    _solve_free_joints(damping + _FLOOR * trace + _TINY, n, work)


def _normal_matrix(rows: int, n: int, work: Matrix) -> float:
    """Fill the lower triangle of H with Gᵀ G; return its trace. Unused rows of G are 0."""
    trace = 0.0
    for a in range(n):
        g0, g1, g2 = work[J_WEIGHTED, a], work[J_WEIGHTED + 1, a], work[J_WEIGHTED + 2, a]
        g3, g4, g5 = work[J_WEIGHTED + 3, a], work[J_WEIGHTED + 4, a], work[J_WEIGHTED + 5, a]
        for b in range(a + 1):
            s = (
                g0 * work[J_WEIGHTED, b]
                + g1 * work[J_WEIGHTED + 1, b]
                + g2 * work[J_WEIGHTED + 2, b]
            )
            if rows > 3:
                s += (
                    g3 * work[J_WEIGHTED + 3, b]
                    + g4 * work[J_WEIGHTED + 4, b]
                    + g5 * work[J_WEIGHTED + 5, b]
                )
            work[HESSIAN + a, b] = s
        trace += work[HESSIAN + a, a]
    return trace


def newton_step(problem: Vector, kind: int, weight: float, n: int, work: Matrix) -> float:
    """Solve with the second derivative, damped until the Hessian is positive definite.

    Returns the damping as a fraction of the largest curvature.
    """
    size, damping = hessian(problem, kind, weight, n, work), _FLOOR
    _mirror_hessian(n, work)
    _fill_rhs(n, work)
    for _ in range(20):
        if _solve_free_joints(damping * size + _TINY, n, work):
            break
        damping = max(4.0 * damping, _FIRST_DAMPING)
        _mirror_hessian(n, work)
    return damping


def _mirror_hessian(n: int, work: Matrix) -> None:
    """Copy H from above the diagonal, which ``hessian`` filled, to below it, for factorisation."""
    for j in range(n):
        for i in range(j):
            work[HESSIAN + j, i] = work[HESSIAN + i, j]
        work[HESSIAN + j, j] = work[HESSIAN + j, n]


def _fill_rhs(n: int, work: Matrix) -> None:
    """Fill RHS with the gradient that remains after the steps of the fixed joints."""
    for a in range(n):
        work[RHS, a] = work[NEG_GRAD, a] * work[FREE, a]
    for b in range(n):
        if work[FREE, b] == 0.0 and work[STEP, b] != 0.0:
            for a in range(n):
                change = work[HESSIAN + max(a, b), min(a, b)] * work[STEP, b]
                work[RHS, a] -= change * work[FREE, a]


def _solve_free_joints(damping: float, n: int, work: Matrix) -> bool:
    """Fill STEP of free joints with (H + damping I)⁻¹ RHS; False if not positive definite."""
    _remove_fixed_joints(n, work)
    if not ldl_factor(work, HESSIAN, n, damping):
        return False
    ldl_solve(work, HESSIAN, n, RHS)
    for j in range(n):
        if work[FREE, j] == 1.0:
            work[STEP, j] = work[RHS, j]
    return True


def _remove_fixed_joints(n: int, work: Matrix) -> None:
    """Make H the identity for the joints that are not free."""
    for j in range(n):
        if work[FREE, j] == 0.0:
            for i in range(j):
                work[HESSIAN + j, i] = 0.0
            for i in range(j + 1, n):
                work[HESSIAN + i, j] = 0.0
            work[HESSIAN + j, j] = 1.0
