"""The nearest point of a planar arm to a point that it cannot reach (lecture L3, L5).

At the nearest point every joint stands at a limit or cannot help: its pivot, the tip and the wanted
point lie on one line. Each joint is therefore at its lower limit, at its upper one, or free, and
the free ones stretch or fold the links along the line: a handful of candidates, all exact.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator, Sequence
from itertools import product

from ikservo.ik.closed_form.links import Angles, Limits, inside, tip_of

__all__ = ["nearest_angles"]


def nearest_angles(
    links: Sequence[complex], limits: Limits, m: complex, start: Angles
) -> tuple[Angles, ...]:
    """Return the angles inside the limits, best first, whose tip may be the nearest to ``m``.

    Args:
        links: The links while all angles are zero.
        limits: Lower and upper limit of each angle.
        m: A point out of reach, from the first joint.
        start: Which turn of an angle to prefer.
    """
    candidates = (
        inside(angles, limits, start)
        for held in product(*(_positions(limit) for limit in limits))
        for angles in _lined_up(links, held, m)
    )
    found = [angles for angles in candidates if angles is not None]
    return tuple(sorted(found, key=lambda angles: abs(tip_of(links, angles) - m)))


def _positions(limit: tuple[float, float]) -> tuple[float | None, ...]:
    """Return where a joint may stand: free (None), or at one of its limits."""
    return (None, *filter(math.isfinite, limit))


def _lined_up(
    links: Sequence[complex], held: Sequence[float | None], m: complex
) -> Iterator[Angles]:
    """Yield the angles that put every piece between free joints along the line to ``m``."""
    pieces = _rigid_pieces(links, held)
    anchor, rest = pieces[0], pieces[1:]
    line = cmath.phase(m - anchor)
    for flips in product((0.0, math.pi), repeat=len(rest)):
        headings = [line + flip - cmath.phase(p) for flip, p in zip(flips, rest, strict=True)]
        yield _angles(held, headings)


def _rigid_pieces(links: Sequence[complex], held: Sequence[float | None]) -> list[complex]:
    """Return the vectors between free joints, each in the coordinates of the joint before it.

    The first piece is held by limits alone, in the coordinates of the base.
    """
    pieces, turned = [0j], 0.0
    for link, angle in zip(links, held, strict=True):
        if angle is None:
            pieces.append(0j)
            turned = 0.0
        else:
            turned += angle
        pieces[-1] += cmath.rect(1.0, turned) * link
    return pieces


def _angles(held: Sequence[float | None], headings: Sequence[float]) -> Angles:
    """Return all angles, the free ones from the headings [rad, base] behind them."""
    angles: list[float] = []
    coming = iter(headings)
    for angle in held:
        angles.append(next(coming) - sum(angles) if angle is None else angle)
    return tuple(angles)
