"""How half the squared error curves: its second derivative, exact unless joints mimic."""

from __future__ import annotations

from ikservo.ik.kernel.compiling import inlined, inner
from ikservo.ik.kernel.desk import ERROR, NORMAL, TOOL, H, J
from ikservo.ik.kernel.layout import DIRECTION, POSITION_ONLY, WANTED_ROTATION
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["bend"]


@inner
def bend(question: Vector, kind: int, weight: float, n: int, desk: Matrix) -> float:
    """Fill H (n, n) above its diagonal, and that into column n; return the largest entry there.

    Turning joint i swings the column of every joint j behind it, d²p/dq_i dq_j = w_i x J_j, and
    likewise every axis r of the tool, d²r/dq_i dq_j = w_i x (w_j x r). With M = Σ r_k d_kᵀ over
    the axes that are compared, the turn's part is ``w_i · (tr(M) - M) w_j``.
    """
    share, trace, size = 0.0, 0.0, 0.0
    if kind != POSITION_ONLY and weight > 0.0:
        share = weight * weight * (1.0 if kind == DIRECTION else 0.5)
        trace = _overlap(question, kind, desk)
    e0, e1, e2 = desk[ERROR, 0], desk[ERROR, 1], desk[ERROR, 2]
    for j in range(n):
        a0, a1, a2 = desk[J, j], desk[J + 1, j], desk[J + 2, j]
        w0, w1, w2 = desk[J + 3, j], desk[J + 4, j], desk[J + 5, j]
        # (w_i x J_j) · e = w_i · (J_j x e)
        m0, m1, m2 = a2 * e1 - a1 * e2, a0 * e2 - a2 * e0, a1 * e0 - a0 * e1
        if share > 0.0:
            m0 += share * (trace * w0 - _row(desk, 0, w0, w1, w2))
            m1 += share * (trace * w1 - _row(desk, 1, w0, w1, w2))
            m2 += share * (trace * w2 - _row(desk, 2, w0, w1, w2))
        for i in range(j + 1):
            turned = desk[J + 3, i] * m0 + desk[J + 4, i] * m1 + desk[J + 5, i] * m2
            desk[H + i, j] = desk[J, i] * a0 + desk[J + 1, i] * a1 + desk[J + 2, i] * a2 + turned
        desk[H + j, n] = desk[H + j, j]
        size = max(size, abs(desk[H + j, n]))
    return size


@inlined
def _overlap(question: Vector, kind: int, desk: Matrix) -> float:
    """Fill M = Σ r_k d_kᵀ (3, 3) into NORMAL; return its trace."""
    first = 2 if kind == DIRECTION else 0
    for a in range(3):
        for b in range(3):
            s = 0.0
            for k in range(first, 3):
                s += desk[TOOL, 3 * a + k] * question[WANTED_ROTATION + 3 * b + k]
            desk[NORMAL + a, b] = s
    return desk[NORMAL, 0] + desk[NORMAL + 1, 1] + desk[NORMAL + 2, 2]


@inlined
def _row(desk: Matrix, a: int, w0: float, w1: float, w2: float) -> float:
    return desk[NORMAL + a, 0] * w0 + desk[NORMAL + a, 1] * w1 + desk[NORMAL + a, 2] * w2
