"""Forward kinematics, residual and Jacobian of the kernel.

Orientations are compared by the chord ``2 sin(angle / 2)``, which is smooth everywhere and grows
with the angle: half its square is 1 - cos(angle).
"""

from __future__ import annotations

import math

from ikservo.kernels.layout import (
    DIRECTION,
    J_WEIGHTED,
    NEG_GRAD,
    NORMS,
    POS_ERR2,
    POSITION_ONLY,
    RESIDUAL,
    ROT_ERR2,
    TOLERANCE_CHORD,
    TOLERANCE_M,
    TOOL_POSE,
    WANTED_POSITION,
    WANTED_ROTATION,
    J,
    Q,
)
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.packed import (
    COLUMN,
    DOF,
    IS_ALIGNED,
    IS_REVOLUTE,
    POSITION,
    SCALE,
    SHIFT,
    STEPS,
)

# A quarter turn in two parts: the first has so few digits that its integer multiples are exact.
_QUARTER, _REST = 1.57079632673412561417, 6.07710050650619224932e-11
_QUARTERS = 2.0 / math.pi
# Numbers of this size have no digits after the point: adding it rounds to the nearest integer.
_ROUND = 1.5 * 2.0**52
# Minimax polynomials for |r| <= π/4, from fdlibm (Sun Microsystems, 1993), k_sin.c and k_cos.c.
_S1, _S2, _S3 = -1.66666666666666324348e-1, 8.33333333332248946124e-3, -1.98412698298579493134e-4
_S4, _S5, _S6 = 2.75573137070700676789e-6, -2.50507602534068634195e-8, 1.58969099521155010221e-10
_C1, _C2, _C3 = 4.16666666666666019037e-2, -1.38888888888741095749e-3, 2.48015872894767294178e-5
_C4, _C5, _C6 = -2.75573143513906633035e-7, 2.08757232129817482790e-9, -1.13596475577881948265e-11


def sincos(angle_rad: float) -> tuple[float, float]:
    """Return cosine and sine, to the last digit or two up to a million radians."""
    quarters = (angle_rad * _QUARTERS + _ROUND) - _ROUND
    r = (angle_rad - quarters * _QUARTER) - quarters * _REST
    z = r * r
    z2 = z * z
    # Evaluated in pairs, which depend on each other less than the terms of one chain do.
    sin = (_S1 + z * _S2) + z2 * ((_S3 + z * _S4) + z2 * (_S5 + z * _S6))
    cos = (_C1 + z * _C2) + z2 * ((_C3 + z * _C4) + z2 * (_C5 + z * _C6))
    sin, cos = r + r * z * sin, (1.0 - 0.5 * z) + z2 * cos
    # Cosine and sine of whole quarter turns, from the remainders by two and by four, because
    # branches would often be mispredicted.
    twos = (quarters * 0.5 + _ROUND) - _ROUND
    fours = (twos * 0.5 + _ROUND) - _ROUND
    b, over = quarters - 2.0 * twos, twos - 2.0 * fours
    a = 1.0 - b * b - 2.0 * over * over
    return a * cos - b * sin, a * sin + b * cos


def forward_kinematics(arm: Matrix, work: Matrix) -> None:
    """Compute the tool pose for the joints Q; fill J (6, n) and TOOL_POSE (12,).

    (x, y, z) are the columns of R_world_joint and p its origin. A revolute joint's column is
    ``z x (tip - p) = p x z + z x tip``: the first term is known at the joint, the second only at
    the tip.
    """
    steps, n = int(arm[0, STEPS]), int(arm[0, DOF])
    for r in range(6):
        for j in range(n):
            work[J + r, j] = 0.0
    x0, x1, x2 = 1.0, 0.0, 0.0
    y0, y1, y2 = 0.0, 1.0, 0.0
    z0, z1, z2 = 0.0, 0.0, 1.0
    p0, p1, p2 = 0.0, 0.0, 0.0
    for i in range(1, steps + 2):
        a, b, c = arm[i, POSITION], arm[i, POSITION + 1], arm[i, POSITION + 2]
        p0 += a * x0 + b * y0 + c * z0
        p1 += a * x1 + b * y1 + c * z1
        p2 += a * x2 + b * y2 + c * z2
        if arm[i, IS_ALIGNED] == 0.0:
            a0, a1, a2 = arm[i, 0], arm[i, 1], arm[i, 2]
            b0, b1, b2 = arm[i, 3], arm[i, 4], arm[i, 5]
            c0, c1, c2 = arm[i, 6], arm[i, 7], arm[i, 8]
            x0, y0, z0 = (
                x0 * a0 + y0 * b0 + z0 * c0,
                x0 * a1 + y0 * b1 + z0 * c1,
                x0 * a2 + y0 * b2 + z0 * c2,
            )
            x1, y1, z1 = (
                x1 * a0 + y1 * b0 + z1 * c0,
                x1 * a1 + y1 * b1 + z1 * c1,
                x1 * a2 + y1 * b2 + z1 * c2,
            )
            x2, y2, z2 = (
                x2 * a0 + y2 * b0 + z2 * c0,
                x2 * a1 + y2 * b1 + z2 * c1,
                x2 * a2 + y2 * b2 + z2 * c2,
            )
        if i > steps:  # the tool's row has no joint
            break
        column, scale = int(arm[i, COLUMN]), arm[i, SCALE]
        value = scale * work[Q, column] + arm[i, SHIFT]
        if arm[i, IS_REVOLUTE] == 0.0:
            p0, p1, p2 = p0 + value * z0, p1 + value * z1, p2 + value * z2
            work[J, column] += scale * z0
            work[J + 1, column] += scale * z1
            work[J + 2, column] += scale * z2
            continue
        cos, sin = sincos(value)
        x0, y0 = cos * x0 + sin * y0, cos * y0 - sin * x0
        x1, y1 = cos * x1 + sin * y1, cos * y1 - sin * x1
        x2, y2 = cos * x2 + sin * y2, cos * y2 - sin * x2
        work[J, column] += scale * (p1 * z2 - p2 * z1)
        work[J + 1, column] += scale * (p2 * z0 - p0 * z2)
        work[J + 2, column] += scale * (p0 * z1 - p1 * z0)
        work[J + 3, column] += scale * z0
        work[J + 4, column] += scale * z1
        work[J + 5, column] += scale * z2
    for j in range(n):
        w0, w1, w2 = work[J + 3, j], work[J + 4, j], work[J + 5, j]
        work[J, j] += w1 * p2 - w2 * p1
        work[J + 1, j] += w2 * p0 - w0 * p2
        work[J + 2, j] += w0 * p1 - w1 * p0
    work[TOOL_POSE, 0], work[TOOL_POSE, 1], work[TOOL_POSE, 2] = x0, y0, z0
    work[TOOL_POSE, 3], work[TOOL_POSE, 4], work[TOOL_POSE, 5] = x1, y1, z1
    work[TOOL_POSE, 6], work[TOOL_POSE, 7], work[TOOL_POSE, 8] = x2, y2, z2
    work[TOOL_POSE, 9], work[TOOL_POSE, 10], work[TOOL_POSE, 11] = p0, p1, p2


def residual_rows(kind: int, weight: float) -> int:
    """Return the number of residual rows; with a rotation weight of 0 only the position's rows."""
    if kind == POSITION_ONLY or weight == 0.0:
        return 3
    return 5 if kind == DIRECTION else 6


def evaluate(arm: Matrix, problem: Vector, kind: int, weight: float, work: Matrix) -> float:
    """Evaluate the residual at Q: fill RESIDUAL, J_WEIGHTED, NEG_GRAD and NORMS.

    Returns half the squared weighted residual.
    """
    n, rows = int(arm[0, DOF]), residual_rows(kind, weight)
    forward_kinematics(arm, work)
    half = _position_rows(problem, n, work)
    if kind == DIRECTION:
        work[NORMS, ROT_ERR2] = _direction_rows(problem, weight, n, work)
    elif kind != POSITION_ONLY:
        work[NORMS, ROT_ERR2] = _pose_rows(problem, weight, n, work)
    e0, e1, e2 = work[RESIDUAL, 0], work[RESIDUAL, 1], work[RESIDUAL, 2]
    for j in range(n):
        s = 0.0 + work[J_WEIGHTED, j] * e0
        s += work[J_WEIGHTED + 1, j] * e1
        s += work[J_WEIGHTED + 2, j] * e2
        for r in range(3, rows):
            s += work[J_WEIGHTED + r, j] * work[RESIDUAL, r]
        work[NEG_GRAD, j] = s
    return half + 0.5 * weight * weight * work[NORMS, ROT_ERR2]


def converged(settings: Vector, fraction: float, work: Matrix) -> bool:
    """Check whether position error and chord are within a fraction of their tolerances."""
    a, b = fraction * settings[TOLERANCE_M], fraction * settings[TOLERANCE_CHORD]
    return work[NORMS, POS_ERR2] <= a * a and work[NORMS, ROT_ERR2] <= b * b


def _position_rows(problem: Vector, n: int, work: Matrix) -> float:
    squared = 0.0
    for r in range(3):
        error = problem[WANTED_POSITION + r] - work[TOOL_POSE, 9 + r]
        work[RESIDUAL, r] = error
        squared += error * error
    for j in range(n):
        for r in range(3):
            work[J_WEIGHTED + r, j] = work[J + r, j]
    work[NORMS, POS_ERR2] = squared
    work[NORMS, ROT_ERR2] = 0.0
    return 0.5 * squared


def _direction_rows(problem: Vector, weight: float, n: int, work: Matrix) -> float:
    """Fill two rows: rotation about the tool's x and y; rotation about z does not matter."""
    x0, y0, z0 = work[TOOL_POSE, 0], work[TOOL_POSE, 1], work[TOOL_POSE, 2]
    x1, y1, z1 = work[TOOL_POSE, 3], work[TOOL_POSE, 4], work[TOOL_POSE, 5]
    x2, y2, z2 = work[TOOL_POSE, 6], work[TOOL_POSE, 7], work[TOOL_POSE, 8]
    d0 = problem[WANTED_ROTATION + 2]
    d1 = problem[WANTED_ROTATION + 5]
    d2 = problem[WANTED_ROTATION + 8]
    work[RESIDUAL, 3] = -weight * (d0 * y0 + d1 * y1 + d2 * y2)
    work[RESIDUAL, 4] = weight * (d0 * x0 + d1 * x1 + d2 * x2)
    for j in range(n):
        w0, w1, w2 = work[J + 3, j], work[J + 4, j], work[J + 5, j]
        work[J_WEIGHTED + 3, j] = weight * (x0 * w0 + x1 * w1 + x2 * w2)
        work[J_WEIGHTED + 4, j] = weight * (y0 * w0 + y1 * w1 + y2 * w2)
        work[J_WEIGHTED + 5, j] = 0.0
    return (d0 - z0) * (d0 - z0) + (d1 - z1) * (d1 - z1) + (d2 - z2) * (d2 - z2)


def _pose_rows(problem: Vector, weight: float, n: int, work: Matrix) -> float:
    """Fill three rows: the remaining rotation ``sin(angle) axis = ½ Σ r_k x d_k``."""
    t0, t1, t2, chord2 = 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        r0, r1, r2 = work[TOOL_POSE, k], work[TOOL_POSE, 3 + k], work[TOOL_POSE, 6 + k]
        d0 = problem[WANTED_ROTATION + k]
        d1 = problem[WANTED_ROTATION + 3 + k]
        d2 = problem[WANTED_ROTATION + 6 + k]
        t0 += r1 * d2 - r2 * d1
        t1 += r2 * d0 - r0 * d2
        t2 += r0 * d1 - r1 * d0
        e0, e1, e2 = r0 - d0, r1 - d1, r2 - d2
        chord2 += e0 * e0 + e1 * e1 + e2 * e2
    work[RESIDUAL, 3] = 0.5 * weight * t0
    work[RESIDUAL, 4] = 0.5 * weight * t1
    work[RESIDUAL, 5] = 0.5 * weight * t2
    for r in range(3, 6):
        for j in range(n):
            work[J_WEIGHTED + r, j] = weight * work[J + r, j]
    return 0.5 * chord2
