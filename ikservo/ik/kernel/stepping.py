"""One step downhill inside the limits: Gauss-Newton or Newton with an active set (lecture L9).

A joint that the step would carry past its limit is set on it, and the others are solved again
for what is left, until none leaves.
"""

from __future__ import annotations

from ikservo.ik.kernel.compiling import inlined, inner
from ikservo.ik.kernel.desk import FREE, HIGH, LOW, PULL, STEP, Q
from ikservo.ik.kernel.directing import least_norm, least_squares, newton
from ikservo.ik.kernel.looking import rows_of
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["curves_down", "downhill", "release"]

# A curvature beyond -_FLAT of the largest is a way down and no flat valley.
_FLAT = 1e-7
# All joints together turn no more than this [rad] in a step: the tip of a long chain, whose joints
# go a little each, would come round a circle. Six joints never do.
_WHOLE = 5.0


@inlined
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


@inlined
def downhill(
    question: Vector,
    kind: int,
    weight: float,
    bent: bool,
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
        if bent:
            newton(question, kind, weight, n, desk)
        elif rows < n:
            least_norm(rows, damping, n, desk)
        else:
            least_squares(rows, damping, n, desk)
        if _all_inside(radius, n, desk):
            break
    longest = 0.0
    for j in range(n):
        longest = max(longest, abs(desk[STEP, j]))
    return longest


@inner
def curves_down(question: Vector, kind: int, weight: float, n: int, desk: Matrix) -> bool:
    """Return whether the free joints stand on a saddle or a top: some way leads down."""
    return newton(question, kind, weight, n, desk) > _FLAT


@inlined
def _all_inside(radius: float, n: int, desk: Matrix) -> bool:
    """Scale the free joints' step; set those that leave their limits on them and return False."""
    longest, whole = 0.0, 0.0
    for j in range(n):
        if desk[FREE, j] == 1.0:
            longest = max(longest, abs(desk[STEP, j]))
            whole += abs(desk[STEP, j])
    scale = radius / longest if longest > radius else 1.0
    if scale * whole > _WHOLE:
        scale = _WHOLE / whole
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
