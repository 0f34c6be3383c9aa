"""Angles that repeat after a full turn, and the one equation that every closed form comes to."""

from __future__ import annotations

import math

__all__ = ["SLACK", "TURN_RAD", "clamped_acos", "turn_inside", "where", "wrapped"]

TURN_RAD = 2.0 * math.pi
# Rounding may push a solution that stands on a limit past it by this much [rad]; it is put back,
# which moves the tool by less than a nanometre.
SLACK = 1e-9
# A cosine this far past one is a point on the boundary, met by rounding.
_EDGE = 1e-10
# An amplitude [m or 1] this small means that the angle does not matter.
_NIL = 1e-9


def wrapped(angle_rad: float) -> float:
    """Return the same angle between -π and π."""
    return math.remainder(angle_rad, TURN_RAD)


def clamped_acos(cosine: float) -> float | None:
    """Return acos, also just past ±1 where rounding put it; None where there is no angle."""
    if not abs(cosine) <= 1.0 + _EDGE:
        return None
    return math.acos(min(max(cosine, -1.0), 1.0))


def turn_inside(angle_rad: float, lower: float, upper: float, near_rad: float) -> float | None:
    """Return the turn of an angle, angle + 2πk, inside the limits and nearest ``near_rad``.

    None where no turn of it is inside.
    """
    turn = angle_rad + TURN_RAD * round((near_rad - angle_rad) / TURN_RAD)
    if turn > upper:
        turn -= TURN_RAD * math.ceil((turn - upper - SLACK) / TURN_RAD)
    elif turn < lower:
        turn += TURN_RAD * math.ceil((lower - turn - SLACK) / TURN_RAD)
    if lower - SLACK <= turn <= upper + SLACK:
        return min(max(turn, lower), upper)
    return None


def where(a: float, b: float, c: float) -> tuple[float, ...] | None:
    """Return the angles θ with ``a cos θ + b sin θ = c``: two, none, or None where any will do."""
    amplitude = math.hypot(a, b)
    if amplitude < _NIL:
        return None if abs(c) < _NIL else ()
    spread = clamped_acos(c / amplitude)
    if spread is None:
        return ()
    middle = math.atan2(b, a)
    return (middle + spread, middle - spread)
