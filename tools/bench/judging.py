"""Score solutions by forward kinematics, in the same way for every solver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from problems import TOOL_AXIS, Array

import ikservo
from ikservo.kinematics.se3 import log_so3

__all__ = ["Flags", "Score", "solved", "worth"]

Flags = NDArray[np.bool_]

_POSITION_M, _ANGLE_RAD = 1e-4, 1e-3
# Solvers in other units round the limits; an excess up to this is not a violation.
_LIMIT_SLACK_RAD = 1e-9


@dataclass(frozen=True)
class Score:
    """The score of one solver in one round.

    Attributes:
        success: Fraction of the reachable targets that it reached.
        median_us: Median time of one call; p95_us and p99_us are percentiles.
        largest_step_rad: Largest joint step between neighbouring targets of one line.
        asked: Number of targets that it tried before its time was up.
        targets: Number of targets.
    """

    success: float
    median_us: float
    p95_us: float
    p99_us: float
    largest_step_rad: float
    asked: int
    targets: int


def solved(chain: ikservo.Chain, kind: str, targets: dict[str, Any], found: list[Any]) -> Array:
    """Return 1.0 for each target (n,) reached inside the limits, NaN if it was not tried."""
    reached = np.full(len(targets["T"]), np.nan)
    for i, q in enumerate(found):
        reached[i] = q is not None and _right(chain, kind, np.array(targets["T"][i]), np.array(q))
    return reached


def worth(
    targets: dict[str, Any], answer: dict[str, Any], reached: Array, possible: Flags
) -> Score:
    """Return the score of one round; ``possible`` says which targets can be reached (n,)."""
    asked = len(answer["time_s"])
    counted = reached[:asked][possible[:asked]]
    median, p95, p99 = np.percentile(np.array(answer["time_s"]) * 1e6, [50, 95, 99])
    return Score(
        success=float(counted.mean()) if len(counted) else 0.0,
        median_us=float(median),
        p95_us=float(p95),
        p99_us=float(p99),
        largest_step_rad=_largest_step(targets["q0"], answer["q"], reached),
        asked=asked,
        targets=len(targets["T"]),
    )


def _right(chain: ikservo.Chain, kind: str, wanted: Array, q: Array) -> bool:
    inside = (q >= chain.lower_rad - _LIMIT_SLACK_RAD) & (q <= chain.upper_rad + _LIMIT_SLACK_RAD)
    if not (np.isfinite(q).all() and inside.all()):
        return False
    T = chain.forward(q)
    if float(np.linalg.norm(T[:3, 3] - wanted[:3, 3])) > _POSITION_M:
        return False
    return kind == "position" or _angle_rad(kind, T[:3, :3], wanted[:3, :3]) <= _ANGLE_RAD


def _angle_rad(kind: str, R: Array, wanted: Array) -> float:
    if kind == "pose":
        return float(np.linalg.norm(log_so3(wanted @ R.T)))
    a, b = R @ TOOL_AXIS, wanted @ TOOL_AXIS
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def _largest_step(starts: list[Any], found: list[Any], reached: Array) -> float:
    """Return the largest step between two neighbouring, correct solutions of a line."""
    largest = 0.0
    for i in range(1, len(found)):
        if starts[i] is None and reached[i] == 1.0 and reached[i - 1] == 1.0:
            step = np.abs(np.array(found[i]) - np.array(found[i - 1])).max()
            largest = max(largest, float(step))
    return largest
