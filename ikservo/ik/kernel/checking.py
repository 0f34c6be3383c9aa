"""Whether a question makes sense: looked at before any step is taken."""

from __future__ import annotations

from ikservo.ik.kernel.compiling import inlined
from ikservo.ik.kernel.layout import DIRECTION, POSITION_ONLY, WANTED_ROTATION
from ikservo.kinematics.se3 import Vector

__all__ = ["is_near", "is_rotation"]

_ROTATION_TOLERANCE = 1e-5


@inlined
def is_near(values: Vector, furthest: float) -> bool:
    """Return whether no value is further from 0 than that, nor NaN."""
    for value in values:  # noqa: SIM110  # numba compiles no generators
        if not abs(value) <= furthest:
            return False
    return True


@inlined
def is_rotation(question: Vector, kind: int) -> bool:
    """Return whether the wanted columns are unit vectors, right-handed and at right angles."""
    if kind == POSITION_ONLY:
        return True
    W = WANTED_ROTATION
    z0, z1, z2 = question[W + 2], question[W + 5], question[W + 8]
    off = abs(z0 * z0 + z1 * z1 + z2 * z2 - 1.0)
    if kind != DIRECTION:
        x0, x1, x2 = question[W], question[W + 3], question[W + 6]
        y0, y1, y2 = question[W + 1], question[W + 4], question[W + 7]
        off += abs(x1 * y2 - x2 * y1 - z0) + abs(x2 * y0 - x0 * y2 - z1)
        off += abs(x0 * y1 - x1 * y0 - z2) + abs(y1 * z2 - y2 * z1 - x0)
        off += abs(y2 * z0 - y0 * z2 - x1) + abs(y0 * z1 - y1 * z0 - x2)
    return off < _ROTATION_TOLERANCE
