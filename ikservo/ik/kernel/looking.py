"""The error E = M - f(q), what it weighs, and how its square changes to first order.

Orientations are compared by the chord ``2 sin(angle / 2)``, which is smooth everywhere and grows
with the angle: half its square is 1 - cos(angle).
"""

from __future__ import annotations

from ikservo.ik.kernel.compiling import inlined
from ikservo.ik.kernel.desk import CHORD2, ERROR, GAP2, GAUGE, PULL, TOOL, G, J
from ikservo.ik.kernel.layout import (
    DIRECTION,
    POSITION_ONLY,
    TOLERANCE_CHORD,
    TOLERANCE_M,
    WANTED_POSITION,
    WANTED_ROTATION,
)
from ikservo.ik.kernel.placing import place
from ikservo.kinematics.packing import DOF
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["look", "met", "rows_of"]


@inlined
def rows_of(kind: int, weight: float) -> int:
    """Return how many rows the error has; a weight of 0 leaves the position only."""
    if kind == POSITION_ONLY or weight == 0.0:
        return 3
    return 5 if kind == DIRECTION else 6


@inlined
def look(arm: Matrix, question: Vector, kind: int, weight: float, desk: Matrix) -> float:
    """Place the arm at Q; fill ERROR, G, PULL and GAUGE; return half the squared error."""
    n, rows = int(arm[0, DOF]), rows_of(kind, weight)
    place(arm, desk)
    half = _position_rows(question, n, desk)
    if kind == DIRECTION:
        desk[GAUGE, CHORD2] = _direction_rows(question, weight, n, desk)
    elif kind != POSITION_ONLY:
        desk[GAUGE, CHORD2] = _pose_rows(question, weight, n, desk)
    for j in range(n):
        pull = 0.0
        for r in range(rows):
            pull += desk[G + r, j] * desk[ERROR, r]
        desk[PULL, j] = pull
    return half + 0.5 * weight * weight * desk[GAUGE, CHORD2]


@inlined
def met(settings: Vector, share: float, desk: Matrix) -> bool:
    """Return whether gap and chord are within a share of their tolerances."""
    a, b = share * settings[TOLERANCE_M], share * settings[TOLERANCE_CHORD]
    return desk[GAUGE, GAP2] <= a * a and desk[GAUGE, CHORD2] <= b * b


@inlined
def _position_rows(question: Vector, n: int, desk: Matrix) -> float:
    gap2 = 0.0
    for r in range(3):
        gap = question[WANTED_POSITION + r] - desk[TOOL, 9 + r]
        desk[ERROR, r] = gap
        gap2 += gap * gap
        for j in range(n):
            desk[G + r, j] = desk[J + r, j]
    desk[GAUGE, GAP2] = gap2
    desk[GAUGE, CHORD2] = 0.0
    return 0.5 * gap2


@inlined
def _direction_rows(question: Vector, weight: float, n: int, desk: Matrix) -> float:
    """Fill two rows: turns about the tool's x and y; those about its own z do not matter."""
    x0, y0, z0 = desk[TOOL, 0], desk[TOOL, 1], desk[TOOL, 2]
    x1, y1, z1 = desk[TOOL, 3], desk[TOOL, 4], desk[TOOL, 5]
    x2, y2, z2 = desk[TOOL, 6], desk[TOOL, 7], desk[TOOL, 8]
    d0 = question[WANTED_ROTATION + 2]
    d1 = question[WANTED_ROTATION + 5]
    d2 = question[WANTED_ROTATION + 8]
    desk[ERROR, 3] = -weight * (d0 * y0 + d1 * y1 + d2 * y2)
    desk[ERROR, 4] = weight * (d0 * x0 + d1 * x1 + d2 * x2)
    for j in range(n):
        w0, w1, w2 = desk[J + 3, j], desk[J + 4, j], desk[J + 5, j]
        desk[G + 3, j] = weight * (x0 * w0 + x1 * w1 + x2 * w2)
        desk[G + 4, j] = weight * (y0 * w0 + y1 * w1 + y2 * w2)
        desk[G + 5, j] = 0.0
    return (d0 - z0) ** 2 + (d1 - z1) ** 2 + (d2 - z2) ** 2


@inlined
def _pose_rows(question: Vector, weight: float, n: int, desk: Matrix) -> float:
    """Fill three rows: the turn ``sin(angle) axis = ½ Σ r_k x d_k`` that is left."""
    t0, t1, t2, chord2 = 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        r0, r1, r2 = desk[TOOL, k], desk[TOOL, 3 + k], desk[TOOL, 6 + k]
        d0 = question[WANTED_ROTATION + k]
        d1 = question[WANTED_ROTATION + 3 + k]
        d2 = question[WANTED_ROTATION + 6 + k]
        t0 += r1 * d2 - r2 * d1
        t1 += r2 * d0 - r0 * d2
        t2 += r0 * d1 - r1 * d0
        chord2 += (r0 - d0) ** 2 + (r1 - d1) ** 2 + (r2 - d2) ** 2
    desk[ERROR, 3] = 0.5 * weight * t0
    desk[ERROR, 4] = 0.5 * weight * t1
    desk[ERROR, 5] = 0.5 * weight * t2
    for r in range(3, 6):
        for j in range(n):
            desk[G + r, j] = weight * desk[J + r, j]
    return 0.5 * chord2
