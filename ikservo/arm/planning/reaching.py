"""What to say of a point that cannot be reached: how near the arm comes, and what to try."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from ikservo.errors import RefusedError, UnreachableError
from ikservo.ik import Result, Target, in_millimetres
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Vector

__all__ = ["suggesting", "unreachable"]

_STEPS_BACK = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4)


def unreachable(target: Target, solution: Result) -> UnreachableError:
    """Return the error that says how near the arm comes to a target."""
    return UnreachableError(
        target.position.tolist(),
        solution.nearest_m.tolist(),
        [str(limit) for limit in solution.binding],
    )


def suggesting(
    error: UnreachableError, chain: Chain, tip_m: Vector, plan: Callable[[Vector], object]
) -> UnreachableError:
    """Return the error with a point in whole millimetres whose motion is accepted, if one is found.

    Args:
        error: What was said of the point.
        chain: The arm.
        tip_m: Where the tip is now (3,).
        plan: Plans the motion to a point (3,) as it was asked for, with all checks.
    """
    instead_m = next(_accepted(np.array(error.nearest_m), tip_m, plan), None)
    better = UnreachableError(error.target_m, error.nearest_m, error.binding, instead_m)
    meant = in_millimetres(chain, error.target_m)
    if meant:
        better.command_hint = f"Did you mean millimetres? Try: ikservo move {meant}"
    return better


def _accepted(
    nearest_m: Vector, tip_m: Vector, plan: Callable[[Vector], object]
) -> Iterator[list[float]]:
    """Yield round points that are accepted, from the edge of the reach towards the tip."""
    for share in _STEPS_BACK:
        point_m = np.round(nearest_m + share * (tip_m - nearest_m), 3)
        try:
            plan(point_m)
        except (UnreachableError, RefusedError):
            continue
        yield [float(x) for x in point_m]
