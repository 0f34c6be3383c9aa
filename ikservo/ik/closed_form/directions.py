"""The directions of the last of three links that the limits allow (lecture L4).

With the direction free, the solutions of a point are intervals. Their ends are known in closed
form: there the two first links are stretched or folded, or a joint stands at a limit, which leaves
two links. Between neighbouring ends nothing changes, so that one look in the middle is enough.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ikservo.ik.closed_form.angles import TURN_RAD, clamped_acos, turn_inside, wrapped
from ikservo.ik.closed_form.links import Angles, Limits, inside, three_links, two_links

__all__ = ["Arc", "allowed_arcs", "nearest_direction", "on_elbows"]

# Ends of an arc are computed, not exact: a choice stays this far inside [rad].
_MARGIN_RAD = 1e-9
_ANYWHERE = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Arc:
    """The directions from ``lower_rad`` to ``upper_rad``, at most a full turn further."""

    lower_rad: float
    upper_rad: float

    def nearest(self, alpha_rad: float) -> float:
        """Return the direction inside that is nearest α on the circle."""
        margin = min(_MARGIN_RAD, 0.5 * (self.upper_rad - self.lower_rad))
        low, high = self.lower_rad + margin, self.upper_rad - margin
        if (turn := turn_inside(alpha_rad, low, high, alpha_rad)) is not None:
            return turn
        return min(low, high, key=lambda end: abs(wrapped(end - alpha_rad)))


def nearest_direction(
    links: Sequence[complex], limits: Limits, m: complex, alpha_rad: float, start: Angles
) -> Iterator[Angles]:
    """Yield, for each elbow and each arc, the angles whose direction is nearest the wanted α.

    Where an elbow can have the wanted direction itself, that is its only answer.
    """
    wanted = on_elbows(links, limits, m, alpha_rad, start)
    yield from (angles for angles in wanted if angles is not None)
    if None not in wanted:
        return
    for elbow, arcs in enumerate(allowed_arcs(links, limits, m)):
        for arc in arcs if wanted[elbow] is None else ():
            found = on_elbows(links, limits, m, arc.nearest(alpha_rad), start)[elbow]
            if found is not None:
                yield found


def allowed_arcs(
    links: Sequence[complex], limits: Limits, m: complex
) -> tuple[tuple[Arc, ...], tuple[Arc, ...]]:
    """Return the directions of the last link with which each elbow reaches ``m``.

    Args:
        links: The three links while all angles are zero.
        limits: Lower and upper limit of each angle.
        m: The wanted point, from the first joint.

    Returns:
        The arcs of the elbow with φ2 >= 0, and those of the elbow with φ2 <= 0.
    """
    # Where no end is known, any direction is as good as 0 to look from: all are open, or none.
    ends = sorted({wrapped(alpha) for alpha in _possible_ends(links, limits, m)}) or [0.0]
    following = [*ends[1:], ends[0] + TURN_RAD]
    middles = [0.5 * (a + b) for a, b in zip(ends, following, strict=True)]
    at_ends = [_open(links, limits, m, alpha) for alpha in ends]
    between = [_open(links, limits, m, alpha) for alpha in middles]
    first, second = (
        _arcs(ends, [looks[elbow] for looks in at_ends], [looks[elbow] for looks in between])
        for elbow in (0, 1)
    )
    return first, second


def _arcs(ends: list[float], at_end: list[bool], after: list[bool]) -> tuple[Arc, ...]:
    """Return the open pieces of the circle, and the open ends between closed pieces."""
    alone = (
        Arc(end, end) for i, end in enumerate(ends) if at_end[i] and not (after[i] or after[i - 1])
    )
    return (*_joined(ends, after), *alone)


def _joined(ends: list[float], after: list[bool]) -> Iterator[Arc]:
    """Join neighbouring open pieces of the circle into arcs."""
    count = len(ends)
    if all(after):
        yield Arc(ends[0], ends[0] + TURN_RAD)
        return
    for first in range(count):
        if not after[first] or after[first - 1]:
            continue
        last = first
        while after[last % count]:
            last += 1
        yield Arc(ends[first], ends[last % count] + (TURN_RAD if last >= count else 0.0))


def _possible_ends(links: Sequence[complex], limits: Limits, m: complex) -> Iterator[float]:
    """Yield every direction at which an arc can end."""
    l1, l2, l3 = links
    stretched, folded = abs(l1) + abs(l2), abs(abs(l1) - abs(l2))
    bent = (abs(l1 + cmath.rect(1.0, b) * l2) for b in limits[1] if math.isfinite(b))
    for reach in (stretched, folded, *bent):
        yield from _third_joint_at(reach, l3, m)
    for a in filter(math.isfinite, limits[0]):
        elbow = m * cmath.rect(1.0, -a) - l1
        yield from (a + b + c for b, c in two_links(l2, l3, elbow))
    for c in filter(math.isfinite, limits[2]):
        yield from (a + b + c for a, b in two_links(l1, l2 + cmath.rect(1.0, c) * l3, m))


def _third_joint_at(reach: float, l3: complex, m: complex) -> tuple[float, ...]:
    """Return the directions that put the third joint at a distance from the first."""
    d, L3 = abs(m), abs(l3)
    if d * L3 == 0.0:
        return ()
    spread = clamped_acos((d * d + L3 * L3 - reach * reach) / (2.0 * d * L3))
    middle = cmath.phase(m) - cmath.phase(l3)
    return () if spread is None else (middle + spread, middle - spread)


def _open(
    links: Sequence[complex], limits: Limits, m: complex, alpha_rad: float
) -> tuple[bool, bool]:
    first, second = on_elbows(links, limits, m, alpha_rad, _ANYWHERE)
    return first is not None, second is not None


def on_elbows(
    links: Sequence[complex], limits: Limits, m: complex, alpha_rad: float, start: Angles
) -> tuple[Angles | None, Angles | None]:
    """Return both elbows with the last link turned by α, each None where limits forbid it."""
    l1, l2, l3 = links
    found = three_links(l1, l2, l3, m, alpha_rad)
    if not found:
        return None, None
    return inside(found[0], limits, start), inside(found[1], limits, start)
