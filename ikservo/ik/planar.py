"""Planar chains with two or three joints, and the intervals of their tool direction.

Points of the plane are complex numbers, so a rotation by θ is a factor e^{iθ}. A link ``l`` is
the vector to the next joint, or to the tip, while all joints are zero; it may be bent, as the
upper arm of most real arms is. The tip is at ``e^{iθ1} (l1 + e^{iθ2} (l2 + e^{iθ3} l3))``.

If the direction is free, the solutions of a point are intervals. Their ends are known in closed
form: there the first two links are stretched or folded, or a joint is at a limit, which leaves two
links. Between neighbouring ends all directions are solutions or no direction is: one sample is
enough.

Along an arc the joints move through the null space of the planar arm: the tip stays, the last
link rotates. Steps along it towards the start have one free parameter.

At the nearest point every joint is at a limit or cannot help: its pivot, the tip and the target
point are on one line. Each joint is therefore at its lower limit, at its upper limit, or free, and
the free joints stretch or fold the links along this line. This gives a few candidates, all exact.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

from ikservo.ik.subproblems import FULL_TURN_RAD, clamped_acos, nearest_equivalent_angle, wrap_angle

Angles = tuple[float, ...]
Limits = Sequence[tuple[float, float]]

# A link shorter than this [m] counts as having no length: its joint does not move the tip.
_NO_LENGTH_M = 1e-9


def planar_tip(links: Sequence[complex], angles: Sequence[float]) -> complex:
    """Return the position of the tip of n links."""
    tip, heading = 0j, 1.0 + 0j
    for link, angle in zip(links, angles, strict=True):
        heading *= cmath.rect(1.0, angle)
        tip += heading * link
    return tip


def solve_planar_2r(l1: complex, l2: complex, m: complex) -> tuple[Angles, ...]:
    """Find (θ1, θ2) of both elbows with the tip at ``m``; empty if ``m`` is out of reach.

    With L1 = |l1|, L2 = |l2|, d = |m|:
    ``cos φ2 = (d² - L1² - L2²) / (2 L1 L2)`` and
    ``φ1 = arg m - atan2(L2 sin φ2, L1 + L2 cos φ2)``,
    measured from straight links: φ1 = θ1 + arg l1, φ2 = θ2 + arg l2 - arg l1. The first elbow has
    φ2 >= 0, the second φ2 <= 0; on the boundary of the annulus they are the same.
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


def solve_planar_3r(
    l1: complex, l2: complex, l3: complex, m: complex, alpha_rad: float
) -> tuple[Angles, ...]:
    """Find (θ1, θ2, θ3) of both elbows with the tip at ``m`` and the last link at α.

    Three links have one more parameter than two: the direction of the last link, which puts the
    third joint at ``m - e^{iα} l3``, and θ3 = α - θ1 - θ2.
    """
    wrist = m - cmath.rect(1.0, alpha_rad) * l3
    return tuple((a, b, alpha_rad - a - b) for a, b in solve_planar_2r(l1, l2, wrist))


def within_limits(angles: Angles, limits: Limits, start: Angles) -> Angles | None:
    """Return the equivalent angles inside the limits, nearest the start, or None."""
    inside: list[float] = []
    for angle, (lower, upper), near in zip(angles, limits, start, strict=True):
        equivalent = nearest_equivalent_angle(angle, lower, upper, near)
        if equivalent is None:
            return None
        inside.append(equivalent)
    return tuple(inside)


# The computed ends of an arc are not exact, so the chosen direction is this far inside them [rad].
_MARGIN_RAD = 1e-9
_ANYWHERE = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class DirectionInterval:
    """Interval of directions of the last planar link with which the tip can reach a point.

    Attributes:
        yaw_rad: The base yaw of the interval; 0 for arms without yaw.
        elbow: 0 or 1.
        lower_rad: First direction, measured from the link's direction while all joints are zero.
        upper_rad: Last direction, at most a full revolution further.
    """

    yaw_rad: float
    elbow: int
    lower_rad: float
    upper_rad: float


@dataclass(frozen=True, slots=True)
class DirectionArc:
    """The directions from ``lower_rad`` to ``upper_rad``, at most a full revolution further."""

    lower_rad: float
    upper_rad: float

    def clamp_direction(self, alpha_rad: float) -> float:
        """Compute the direction of the arc that is nearest to α on the circle."""
        margin = min(_MARGIN_RAD, 0.5 * (self.upper_rad - self.lower_rad))
        low, high = self.lower_rad + margin, self.upper_rad - margin
        if (equivalent := nearest_equivalent_angle(alpha_rad, low, high, alpha_rad)) is not None:
            return equivalent
        return min(low, high, key=lambda end: abs(wrap_angle(end - alpha_rad)))


def nearest_direction(
    links: Sequence[complex], limits: Limits, m: complex, alpha_rad: float, start: Angles
) -> Iterator[Angles]:
    """Yield, for each elbow and each arc, the joint angles with the direction nearest the target α.

    If an elbow allows the target direction itself, only those angles are yielded for it.
    """
    direct = elbow_solutions(links, limits, m, alpha_rad, start)
    yield from (angles for angles in direct if angles is not None)
    if None not in direct:
        return
    for elbow, arcs in enumerate(allowed_arcs(links, limits, m)):
        for arc in arcs if direct[elbow] is None else ():
            found = elbow_solutions(links, limits, m, arc.clamp_direction(alpha_rad), start)[elbow]
            if found is not None:
                yield found


def allowed_arcs(
    links: Sequence[complex], limits: Limits, m: complex
) -> tuple[tuple[DirectionArc, ...], tuple[DirectionArc, ...]]:
    """Return the directions of the last link with which each elbow reaches ``m``.

    ``links`` are the vectors of the links at zero angles; ``m`` is relative to the first joint.

    Returns:
        The arcs of the elbow with φ2 >= 0, and those of the elbow with φ2 <= 0.
    """
    # Without known ends, direction 0 is sampled: all directions are allowed, or no direction is.
    ends = sorted({wrap_angle(alpha) for alpha in _possible_ends(links, limits, m)}) or [0.0]
    following = [*ends[1:], ends[0] + FULL_TURN_RAD]
    middles = [0.5 * (a + b) for a, b in zip(ends, following, strict=True)]
    at_ends = [_allowed_elbows(links, limits, m, alpha) for alpha in ends]
    between = [_allowed_elbows(links, limits, m, alpha) for alpha in middles]
    first, second = (
        _open_arcs(
            ends, [samples[elbow] for samples in at_ends], [samples[elbow] for samples in between]
        )
        for elbow in (0, 1)
    )
    return first, second


def _open_arcs(
    ends: list[float], at_end: list[bool], after: list[bool]
) -> tuple[DirectionArc, ...]:
    """Return the arcs of allowed directions; a single allowed direction is an arc of length 0."""
    if all(after):
        return (DirectionArc(ends[0], ends[0] + FULL_TURN_RAD),)
    count, arcs = len(ends), list[DirectionArc]()
    for first in range(count):
        if not after[first] or after[first - 1]:
            continue  # no arc begins here
        last = first
        while after[last % count]:
            last += 1
        beyond = FULL_TURN_RAD if last >= count else 0.0
        arcs.append(DirectionArc(ends[first], ends[last % count] + beyond))
    for i, end in enumerate(ends):
        if at_end[i] and not (after[i] or after[i - 1]):
            arcs.append(DirectionArc(end, end))
    return tuple(arcs)


def _possible_ends(links: Sequence[complex], limits: Limits, m: complex) -> Iterator[float]:
    """Yield every direction at which an arc can end."""
    l1, l2, l3 = links
    stretched, folded = abs(l1) + abs(l2), abs(abs(l1) - abs(l2))
    bent = (abs(l1 + cmath.rect(1.0, b) * l2) for b in limits[1] if math.isfinite(b))
    d, L3, middle = abs(m), abs(l3), cmath.phase(m) - cmath.phase(l3)
    for reach in (stretched, folded, *bent) if d * L3 else ():
        # The directions that put the third joint at this distance from the first joint.
        spread = clamped_acos((d * d + L3 * L3 - reach * reach) / (2.0 * d * L3))
        yield from () if spread is None else (middle + spread, middle - spread)
    for a in filter(math.isfinite, limits[0]):
        elbow = m * cmath.rect(1.0, -a) - l1
        yield from (a + b + c for b, c in solve_planar_2r(l2, l3, elbow))
    for c in filter(math.isfinite, limits[2]):
        yield from (a + b + c for a, b in solve_planar_2r(l1, l2 + cmath.rect(1.0, c) * l3, m))


def _allowed_elbows(
    links: Sequence[complex], limits: Limits, m: complex, alpha_rad: float
) -> tuple[bool, bool]:
    first, second = elbow_solutions(links, limits, m, alpha_rad, _ANYWHERE)
    return first is not None, second is not None


def elbow_solutions(
    links: Sequence[complex], limits: Limits, m: complex, alpha_rad: float, start: Angles
) -> tuple[Angles | None, Angles | None]:
    """Return both elbows' angles with the last link at α; None for an elbow that limits forbid."""
    l1, l2, l3 = links
    found = solve_planar_3r(l1, l2, l3, m, alpha_rad)
    if not found:
        return None, None
    return within_limits(found[0], limits, start), within_limits(found[1], limits, start)


_STEPS = 20
_STEP_END_RAD = 1e-6
# Samples in addition to the direction at the start, as fractions of the arc.
_SAMPLES = (0.05, 0.2, 0.35, 0.5, 0.65, 0.8, 0.95)


def nearest_on_direction_arcs(
    links: Sequence[complex], limits: Limits, m: complex, start: Angles
) -> Iterator[Angles]:
    """Yield, for each elbow and each arc of directions, the angles nearest the start."""
    for elbow, arcs in enumerate(allowed_arcs(links, limits, m)):
        for arc in arcs:
            yield from _nearest_on_arc(links, limits, m, elbow, arc, start)


def _nearest_on_arc(
    links: Sequence[complex],
    limits: Limits,
    m: complex,
    elbow: int,
    arc: DirectionArc,
    start: Angles,
) -> Iterator[Angles]:
    """Yield angles that minimise ``|θ(α) - θ_start|²`` on an arc, refined from the best sample."""

    def at(alpha_rad: float) -> Angles | None:
        return elbow_solutions(links, limits, m, arc.clamp_direction(alpha_rad), start)[elbow]

    span = arc.upper_rad - arc.lower_rad
    samples = (sum(start), *(arc.lower_rad + part * span for part in _SAMPLES))
    found = [angles for angles in map(at, samples) if angles is not None]
    if not found:
        return
    best, scale = min(found, key=lambda angles: _squared_distance(angles, start)), 1.0
    for _ in range(_STEPS):
        step = scale * _step_towards(links, best, start)
        if abs(step) < _STEP_END_RAD:
            break
        candidate = at(sum(best) + step)
        if candidate is not None and _squared_distance(candidate, start) < _squared_distance(
            best, start
        ):
            best, scale = candidate, 1.0
        else:
            scale *= 0.5
    yield best


def _step_towards(links: Sequence[complex], angles: Angles, start: Angles) -> float:
    """Compute the change of α that brings the angles nearest the start, to first order.

    The rotated links v1, v2, v3 end at the target point. To keep it there, the angles change
    along ``t = (v2×v3, -v1×v3 - v2×v3, v1×v2 + v1×v3)``, and α with the sum of t, v1×v2.
    """
    heading, v = 1.0 + 0j, list[complex]()
    for link, angle in zip(links, angles, strict=True):
        heading *= cmath.rect(1.0, angle)
        v.append(heading * link)
    c12, c13, c23 = _cross_2d(v[0], v[1]), _cross_2d(v[0], v[2]), _cross_2d(v[1], v[2])
    t = (c23, -c13 - c23, c12 + c13)
    length2 = sum(x * x for x in t)
    towards = sum((s - a) * x for s, a, x in zip(start, angles, t, strict=True))
    return c12 * towards / length2 if length2 else 0.0


def _cross_2d(a: complex, b: complex) -> float:
    return (a.conjugate() * b).imag


def _squared_distance(angles: Angles, start: Angles) -> float:
    return sum((a - s) ** 2 for a, s in zip(angles, start, strict=True))


def nearest_planar_angles(
    links: Sequence[complex], limits: Limits, m: complex, start: Angles
) -> tuple[Angles, ...]:
    """Find the angles inside the limits, best first, whose tip may be the nearest to ``m``.

    ``links`` are the vectors of the links at zero angles; ``m``, relative to the first joint, is
    out of reach. Among equivalent angles, those nearest ``start`` are returned.
    """
    candidates = (
        within_limits(angles, limits, start)
        # Each joint is free (None) or at one of its limits.
        for held in product(*((None, *filter(math.isfinite, limit)) for limit in limits))
        for angles in _aligned_angles(links, held, m)
    )
    found = [angles for angles in candidates if angles is not None]
    return tuple(sorted(found, key=lambda angles: abs(planar_tip(links, angles) - m)))


def _aligned_angles(
    links: Sequence[complex], held: Sequence[float | None], m: complex
) -> Iterator[Angles]:
    """Yield the angles that put every piece between free joints along the line to ``m``."""
    pieces = _rigid_pieces(links, held)
    anchor, rest = pieces[0], pieces[1:]
    line = cmath.phase(m - anchor)
    for flips in product((0.0, math.pi), repeat=len(rest)):
        headings = (line + flip - cmath.phase(p) for flip, p in zip(flips, rest, strict=True))
        angles: list[float] = []
        for angle in held:  # a free joint rotates the piece after it to its heading
            angles.append(next(headings) - sum(angles) if angle is None else angle)
        yield tuple(angles)


def _rigid_pieces(links: Sequence[complex], held: Sequence[float | None]) -> list[complex]:
    """Return the vectors between free joints, each in the coordinates of the joint before it.

    The first piece has only joints at limits; it is in the coordinates of the base.
    """
    pieces, rotation_rad = [0j], 0.0
    for link, angle in zip(links, held, strict=True):
        if angle is None:
            pieces.append(0j)
            rotation_rad = 0.0
        else:
            rotation_rad += angle
        pieces[-1] += cmath.rect(1.0, rotation_rad) * link
    return pieces
