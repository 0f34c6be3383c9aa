"""Two and three turning links in a plane (lecture L3, L4).

Points of the plane are complex numbers, so that a turn by θ is a factor e^{iθ}. A link ``l`` is
the vector to the next joint, or to the tip, while all joints are zero: it may be bent, as the
upper arm of most real arms is. The tip stands at ``e^{iθ1} (l1 + e^{iθ2} (l2 + e^{iθ3} l3))``.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence

from ikservo.ik.closed_form.angles import clamped_acos, turn_inside

__all__ = ["Angles", "Limits", "inside", "three_links", "tip_of", "two_links"]

Angles = tuple[float, ...]
Limits = Sequence[tuple[float, float]]

# A link shorter than this [m] is none: its joint does not move the tip.
_NO_LENGTH_M = 1e-9


def tip_of(links: Sequence[complex], angles: Sequence[float]) -> complex:
    """Return where the tip of n links stands (lecture L2)."""
    tip, heading = 0j, 1.0 + 0j
    for link, angle in zip(links, angles, strict=True):
        heading *= cmath.rect(1.0, angle)
        tip += heading * link
    return tip


def two_links(l1: complex, l2: complex, m: complex) -> tuple[Angles, ...]:
    """Return both elbows (θ1, θ2) that bring the tip to ``m``, none outside the annulus.

    With L1 = |l1|, L2 = |l2|, d = |m| (lecture L3):
    ``cos φ2 = (d² - L1² - L2²) / (2 L1 L2)`` and
    ``φ1 = arg m - atan2(L2 sin φ2, L1 + L2 cos φ2)``,
    counted from straight links: φ1 = θ1 + arg l1, φ2 = θ2 + arg l2 - arg l1. The first elbow has
    φ2 >= 0, the second φ2 <= 0; on the boundary of the annulus they are one.
    """
    L1, L2, d = abs(l1), abs(l2), abs(m)
    if min(L1, L2) < _NO_LENGTH_M:
        return ()
    bend = clamped_acos((d * d - L1 * L1 - L2 * L2) / (2.0 * L1 * L2))
    if bend is None:
        return ()
    lean = math.atan2(L2 * math.sin(bend), L1 + L2 * math.cos(bend))
    a1, a2, heading = cmath.phase(l1), cmath.phase(l2), cmath.phase(m)
    return (
        (heading - lean - a1, bend - a2 + a1),
        (heading + lean - a1, -bend - a2 + a1),
    )


def three_links(
    l1: complex, l2: complex, l3: complex, m: complex, alpha_rad: float
) -> tuple[Angles, ...]:
    """Return both elbows (θ1, θ2, θ3) that bring the tip to ``m`` with the last link turned by α.

    The direction of the last link is the parameter that three links have more than two
    (lecture L4): it puts the third joint at ``m - e^{iα} l3``, and θ3 = α - θ1 - θ2.
    """
    wrist = m - cmath.rect(1.0, alpha_rad) * l3
    return tuple((a, b, alpha_rad - a - b) for a, b in two_links(l1, l2, wrist))


def inside(angles: Angles, limits: Limits, start: Angles) -> Angles | None:
    """Return the turns of the angles inside the limits, nearest the start, or None."""
    turns: list[float] = []
    for angle, (lower, upper), near in zip(angles, limits, start, strict=True):
        turn = turn_inside(angle, lower, upper, near)
        if turn is None:
            return None
        turns.append(turn)
    return tuple(turns)
