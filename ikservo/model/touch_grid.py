"""The printed grid sheet for a touch-off."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ikservo.kinematics.arrays import Vector
from ikservo.model.model import Model
from ikservo.model.tool import view_axes

__all__ = [
    "COLUMNS",
    "EDGE_M",
    "HIGH_M",
    "ROWS",
    "STEP_M",
    "WIDE_M",
    "TouchTarget",
    "grid_points",
    "place_sheet",
]

WIDE_M, HIGH_M = 0.297, 0.210  # A4, its long edge before the arm
EDGE_M = 0.030  # from the near edge to the first row
STEP_M = 0.050
ROWS, COLUMNS = "1234", "ABCDE"  # rows away from the arm, columns from its left to its right

_MIN_DISTANCE_M = 0.05
_MIDDLE_M = EDGE_M + 0.5 * STEP_M * (len(ROWS) - 1)


@dataclass(frozen=True, slots=True, eq=False)
class TouchTarget:
    """A point that the tip shall be put on.

    Attributes:
        name: As on the sheet: ``B3``; ``B3 block`` on top of a block that stands there.
        position_m: Where it is (3,), metres, base frame; None where nobody has measured it.
    """

    name: str
    position_m: Vector | None = None


def grid_points() -> Iterator[tuple[str, float, float]]:
    """Yield each cross: name, metres from the near edge, metres left of the middle."""
    for i, row in enumerate(ROWS):
        for k, column in enumerate(COLUMNS):
            yield f"{column}{row}", EDGE_M + i * STEP_M, (2 - k) * STEP_M


def place_sheet(
    model: Model, edge_m: float | None, block_m: float | None
) -> tuple[float, list[TouchTarget]]:
    """Return the sheet as it lies before an arm.

    Args:
        model: The arm; straight ahead is where its tool is in the pose ``home``.
        edge_m: From the arm's base frame straight ahead to the near edge; None for where the
            middle of the sheet lies beneath that tool.
        block_m: How high a block is that the tip is put on at every other cross, if there is one.

    Returns:
        The distance of the near edge [m], and the places in the order in which to touch them.
    """
    ahead, left, up = view_axes(model)
    reach_m = float(ahead @ model.chain.forward(model.chain_pose("home"))[:3, 3])
    nominal_m = max(_MIN_DISTANCE_M, math.floor((reach_m - _MIDDLE_M) * 100) / 100)
    edge_m = nominal_m if edge_m is None else edge_m
    floor: Vector = np.array([0.0, 0.0, model.floor_m or 0.0])
    places: list[TouchTarget] = []
    for i, (name, out_m, left_m) in enumerate(grid_points()):
        spot: Vector = floor + (edge_m + out_m) * ahead + left_m * left
        if block_m is None or i % 2 == 0:
            places.append(TouchTarget(name, spot))
        else:
            places.append(TouchTarget(f"{name} block", spot + block_m * up))
    return edge_m, places
