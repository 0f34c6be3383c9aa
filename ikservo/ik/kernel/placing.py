"""Where the tool is for given joints, and how it moves (lecture L2, L6)."""

from __future__ import annotations

from ikservo.ik.kernel.compiling import inlined
from ikservo.ik.kernel.desk import TOOL, J, Q
from ikservo.ik.kernel.turning import cos_sin
from ikservo.kinematics.packing import COLUMN, DOF, POSITION, SCALE, SHIFT, STEPS, TURNS
from ikservo.kinematics.se3 import Matrix

__all__ = ["place"]


@inlined
def place(arm: Matrix, desk: Matrix) -> None:
    """Walk from the base to the tool for the joints Q; fill J (6, n) and TOOL (12,).

    (x, y, z) are the columns of R_world_joint and p its origin. A turning joint's column is
    ``z x (tip - p) = p x z + z x tip``: the first part is known on the way, the second at its end.
    """
    steps, n = int(arm[0, STEPS]), int(arm[0, DOF])
    for r in range(6):
        for j in range(n):
            desk[J + r, j] = 0.0
    x0, x1, x2 = 1.0, 0.0, 0.0
    y0, y1, y2 = 0.0, 1.0, 0.0
    z0, z1, z2 = 0.0, 0.0, 1.0
    p0, p1, p2 = 0.0, 0.0, 0.0
    for i in range(1, steps + 2):
        a, b, c = arm[i, POSITION], arm[i, POSITION + 1], arm[i, POSITION + 2]
        p0 += a * x0 + b * y0 + c * z0
        p1 += a * x1 + b * y1 + c * z1
        p2 += a * x2 + b * y2 + c * z2
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
        if i > steps:  # the tool does not move against the last joint
            break
        column, scale = int(arm[i, COLUMN]), arm[i, SCALE]
        value = scale * desk[Q, column] + arm[i, SHIFT]
        if arm[i, TURNS] == 0.0:
            p0, p1, p2 = p0 + value * z0, p1 + value * z1, p2 + value * z2
            desk[J, column] += scale * z0
            desk[J + 1, column] += scale * z1
            desk[J + 2, column] += scale * z2
            continue
        cos, sin = cos_sin(value)
        x0, y0 = cos * x0 + sin * y0, cos * y0 - sin * x0
        x1, y1 = cos * x1 + sin * y1, cos * y1 - sin * x1
        x2, y2 = cos * x2 + sin * y2, cos * y2 - sin * x2
        desk[J, column] += scale * (p1 * z2 - p2 * z1)
        desk[J + 1, column] += scale * (p2 * z0 - p0 * z2)
        desk[J + 2, column] += scale * (p0 * z1 - p1 * z0)
        desk[J + 3, column] += scale * z0
        desk[J + 4, column] += scale * z1
        desk[J + 5, column] += scale * z2
    for j in range(n):
        w0, w1, w2 = desk[J + 3, j], desk[J + 4, j], desk[J + 5, j]
        desk[J, j] += w1 * p2 - w2 * p1
        desk[J + 1, j] += w2 * p0 - w0 * p2
        desk[J + 2, j] += w0 * p1 - w1 * p0
    desk[TOOL, 0], desk[TOOL, 1], desk[TOOL, 2] = x0, y0, z0
    desk[TOOL, 3], desk[TOOL, 4], desk[TOOL, 5] = x1, y1, z1
    desk[TOOL, 6], desk[TOOL, 7], desk[TOOL, 8] = x2, y2, z2
    desk[TOOL, 9], desk[TOOL, 10], desk[TOOL, 11] = p0, p1, p2
