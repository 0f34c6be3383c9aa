"""Yaw and roll of an arm from what is across its plane: two circles in step.

With the yaw φ and the roll ψ two equations must hold together::

    M(φ) = w(ψ)     the wanted point and the tool point are equally far across the plane
    d(φ) = a(ψ)     the wanted direction and the tool axis lean equally far out of it

Both sides are linear in cos and sin, so that eliminating φ leaves an equation of fourth degree
in e^{iψ}.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator

import numpy as np

from ikservo.ik.closed_form.angles import wrapped
from ikservo.ik.closed_form.orbits import Orbit

__all__ = ["NO_FREEDOM", "ROUNDED", "sharpened", "yaw_and_roll"]

# Circles this small [m or 1] are no freedom that an arm can use.
NO_FREEDOM = 1e-6
# Published axes are rounded to about 1e-5 rad: straight down is straight down for every yaw.
ROUNDED = 1e-5
# A root of the quartic may stand this far beside the unit circle where two roots nearly agree.
_BESIDE_CIRCLE = 1e-3
_NEWTON_STEPS = 4
_RESIDUAL = 1e-11
_ONE_PAIR = 1e-6


def yaw_and_roll(
    M: Orbit, w: Orbit, d: Orbit, a: Orbit, held_rad: tuple[float, float]
) -> Iterator[tuple[float, float]]:
    """Yield every (φ, ψ) with ``M(φ) = w(ψ)`` and ``d(φ) = a(ψ)`` across the plane.

    Where one of them does not matter it stays as held (φ, ψ). A direction that matters little
    beside its tolerance, or a roll that moves nothing, leaves one equation.
    """
    roll_matters = max(w.sway, a.sway) > NO_FREEDOM
    direction_matters = max(d.sway, a.sway) > ROUNDED
    if not roll_matters or not direction_matters:
        yield from _with_roll_held(M, w, d, a, held_rad)
        return
    found: list[tuple[float, float]] = []
    for psi in _rolls(M, w, d, a):
        for phi in _yaws(M, w, d, a, psi):
            pair = sharpened(M, w, d, a, phi, psi)
            if pair is not None and not any(_same(pair, other) for other in found):
                found.append(pair)
    yield from found


def _with_roll_held(
    M: Orbit, w: Orbit, d: Orbit, a: Orbit, held_rad: tuple[float, float]
) -> Iterator[tuple[float, float]]:
    phi, psi = held_rad
    angles = M.where_across(w.across(psi))
    if angles is None:  # the point is on the axis of yaw: only the direction can tell
        angles = d.where_across(a.across(psi))
    yield from ((angle, psi) for angle in ((phi,) if angles is None else angles))


def _rolls(M: Orbit, w: Orbit, d: Orbit, a: Orbit) -> Iterator[float]:
    """Yield the angles ψ of the quartic's roots on the unit circle.

    With u = (cos φ, sin φ) and v = (cos ψ, sin ψ) the equations are ``A u = B v + b``. The
    adjugate of A gives ``det A u = C v + c``, and u has length one: ``|C v + c|² = det² A``. With
    y = e^{iψ} and ``C v = h y + h̄ / y`` that is a polynomial in y.
    """
    adjugate = np.array([[d.a2, -M.a2], [-d.a1, M.a1]])
    C = adjugate @ np.array([[w.a1, w.a2], [a.a1, a.a2]])
    c = adjugate @ np.array([w.a0 - M.a0, a.a0 - d.a0])
    det = M.a1 * d.a2 - M.a2 * d.a1
    h = 0.5 * (C[:, 0] - 1j * C[:, 1])
    middle = 2.0 * (h @ h.conj()) + c @ c - det * det
    for y in np.roots([h @ h, 2.0 * (h @ c), middle, 2.0 * (h.conj() @ c), (h @ h).conj()]):
        if abs(abs(y) - 1.0) < _BESIDE_CIRCLE:
            yield cmath.phase(complex(y))


def _yaws(M: Orbit, w: Orbit, d: Orbit, a: Orbit, psi: float) -> tuple[float, ...]:
    """Return the yaws that the stronger of the two equations gives for a roll."""
    if d.sway > M.sway:
        return d.where_across(a.across(psi)) or ()
    return M.where_across(w.across(psi)) or ()


def sharpened(
    M: Orbit, w: Orbit, d: Orbit, a: Orbit, phi: float, psi: float
) -> tuple[float, float] | None:
    """Return the pair after Newton steps on both equations, or None if they do not hold there."""
    for _ in range(_NEWTON_STEPS):
        e, f = w.across(psi) - M.across(phi), a.across(psi) - d.across(phi)
        if math.hypot(e, f) < _RESIDUAL:
            return phi, psi
        m1, w1, d1, a1 = M.slope(phi), -w.slope(psi), d.slope(phi), -a.slope(psi)
        det = m1 * a1 - w1 * d1
        if det == 0.0:
            return None
        phi += (e * a1 - f * w1) / det
        psi += (f * m1 - e * d1) / det
    return None


def _same(one: tuple[float, float], other: tuple[float, float]) -> bool:
    return all(abs(wrapped(p - q)) < _ONE_PAIR for p, q in zip(one, other, strict=True))
