"""What to say of a point that cannot be reached: how near the arm comes, and what to try."""

from __future__ import annotations

import numpy as np

from ikservo.errors import UnreachableError
from ikservo.ik import Result, Target, solve
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Vector

__all__ = ["unreachable"]

_STEPS_BACK = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2)


def unreachable(chain: Chain, target: Target, solution: Result, tip_m: Vector) -> UnreachableError:
    """Say how near the arm can come, and offer a point in whole millimetres that it reaches.

    Args:
        chain: The arm.
        target: The point that was asked for.
        solution: The nearest that was found.
        tip_m: Where the tip is now (3,).
    """
    return UnreachableError(
        target.position.tolist(),
        solution.nearest_m.tolist(),
        [str(limit) for limit in solution.binding],
        _instead(chain, solution.nearest_m, tip_m, solution.q),
    )


def _instead(chain: Chain, nearest_m: Vector, tip_m: Vector, q: Vector) -> list[float] | None:
    """Step back from the edge towards where the tip is until a round point is reachable."""
    for share in _STEPS_BACK:
        point_m = np.round(nearest_m + share * (tip_m - nearest_m), 3)
        if solve(chain, Target(point_m), q, restarts=4).reached:
            return [float(x) for x in point_m]
    return None
