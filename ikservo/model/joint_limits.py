"""How close a joint stands to its limits: one definition for plans, tables and the page."""

from __future__ import annotations

import math

__all__ = ["at_limit", "limit_distance", "near_distance", "near_limit"]

_NEAR = {"rad": math.radians(5.0), "m": 0.005}
_AT = {"rad": math.radians(0.3), "m": 0.0003}
_NEAR_SHARE = 1 / 20  # of a range that is short: else a gripper's jaws would always be near


def limit_distance(position: float, lower: float, upper: float) -> float:
    """Return how far a position is inside the nearer limit; negative outside, infinite for none."""
    return min(position - lower, upper - position)


def near_distance(lower: float, upper: float, unit: str) -> float:
    """Return the distance from a limit within which a joint is near it.

    Args:
        lower: The lower limit, rad or m.
        upper: The upper limit.
        unit: ``rad`` or ``m``.
    """
    return min(_NEAR[unit], _NEAR_SHARE * (upper - lower))


def near_limit(position: float, lower: float, upper: float, unit: str = "rad") -> bool:
    """Return whether a joint is within 5° (5 mm) of a limit, or a twentieth of a shorter range."""
    return limit_distance(position, lower, upper) <= near_distance(lower, upper, unit)


def at_limit(position: float, lower: float, upper: float, unit: str = "rad") -> bool:
    """Return whether a joint is within 0.3° (0.3 mm) of a limit, or beyond it."""
    at = min(_AT[unit], near_distance(lower, upper, unit))
    return limit_distance(position, lower, upper) <= at
