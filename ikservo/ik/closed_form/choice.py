"""Which direction to take where an interval of them is allowed: the joints nearest the start (L4).

Along an arc the joints slide through the null space of the planar arm: the tip stays, the last
link turns. Steps along it towards the start are the lecture's L10 with one free parameter.
"""

from __future__ import annotations

import cmath
from collections.abc import Iterator, Sequence

from ikservo.ik.closed_form.directions import Arc, allowed_arcs, on_elbows
from ikservo.ik.closed_form.links import Angles, Limits

__all__ = ["nearest_angles_on_arcs"]

_STEPS = 20
_STEP_END_RAD = 1e-6
# Where to look first beside the start's own direction, as parts of the arc.
_LOOKS = (0.05, 0.2, 0.35, 0.5, 0.65, 0.8, 0.95)


def nearest_angles_on_arcs(
    links: Sequence[complex], limits: Limits, m: complex, start: Angles
) -> Iterator[Angles]:
    """Yield, for each elbow and each arc of directions, the angles nearest the start."""
    for elbow, arcs in enumerate(allowed_arcs(links, limits, m)):
        for arc in arcs:
            yield from _nearest_on_arc(links, limits, m, elbow, arc, start)


def _nearest_on_arc(
    links: Sequence[complex], limits: Limits, m: complex, elbow: int, arc: Arc, start: Angles
) -> Iterator[Angles]:
    """Yield the angles that minimise ``|θ(α) - θ_start|²`` on one arc, from the best look."""

    def at(alpha_rad: float) -> Angles | None:
        return on_elbows(links, limits, m, arc.nearest(alpha_rad), start)[elbow]

    span = arc.upper_rad - arc.lower_rad
    looks = (sum(start), *(arc.lower_rad + part * span for part in _LOOKS))
    found = [angles for angles in map(at, looks) if angles is not None]
    if not found:
        return
    best, scale = min(found, key=lambda angles: _distance(angles, start)), 1.0
    for _ in range(_STEPS):
        step = scale * _step_towards(links, best, start)
        if abs(step) < _STEP_END_RAD:
            break
        tried = at(sum(best) + step)
        if tried is not None and _distance(tried, start) < _distance(best, start):
            best, scale = tried, 1.0
        else:
            scale *= 0.5
    yield best


def _step_towards(links: Sequence[complex], angles: Angles, start: Angles) -> float:
    """Return the change of α that brings the angles nearest the start, to first order.

    The links v1, v2, v3 as they stand close with the wanted point; keeping it, the angles change
    along ``t = (v2×v3, -v1×v3 - v2×v3, v1×v2 + v1×v3)``, and α with the sum of t, v1×v2.
    """
    heading, v = 1.0 + 0j, list[complex]()
    for link, angle in zip(links, angles, strict=True):
        heading *= cmath.rect(1.0, angle)
        v.append(heading * link)
    c12, c13, c23 = _cross(v[0], v[1]), _cross(v[0], v[2]), _cross(v[1], v[2])
    t = (c23, -c13 - c23, c12 + c13)
    length2 = sum(x * x for x in t)
    towards = sum((s - a) * x for s, a, x in zip(start, angles, t, strict=True))
    return c12 * towards / length2 if length2 else 0.0


def _cross(a: complex, b: complex) -> float:
    return (a.conjugate() * b).imag


def _distance(angles: Angles, start: Angles) -> float:
    return sum((a - s) ** 2 for a, s in zip(angles, start, strict=True))
