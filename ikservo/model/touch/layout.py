"""What a touch-off estimates, in which order, and what is believed of it beforehand."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np

from ikservo.kinematics import Chain, JointKind
from ikservo.kinematics.geometry import Geometry, movable_origins
from ikservo.kinematics.se3 import Vector

__all__ = ["Extent", "Layout", "Parameter"]

# Standard deviations before the first touch: a zero that was held by eye, printed links, a sheet
# that was laid before the arm by its edge.
ZERO_RAD, ZERO_M = math.radians(3.0), 0.002
BASE_M, BASE_RAD = 0.004, math.radians(1.0)
ORIGIN_M = 0.0012
POINT_M = 0.1


class Extent(Enum):
    """How much of the arm is estimated."""

    NOTHING = "nothing"
    ZEROS = "zeros"
    BASE = "zeros and base"
    LINKS = "zeros and links"
    EVERYTHING = "zeros, base and links"

    @property
    def base(self) -> bool:
        """Return whether the base may stand elsewhere."""
        return self in (Extent.BASE, Extent.EVERYTHING)

    @property
    def links(self) -> bool:
        """Return whether links may have other lengths."""
        return self in (Extent.LINKS, Extent.EVERYTHING)


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number of a touch-off.

    Attributes:
        name: ``elbow_flex zero``, ``base x``, ``elbow_flex origin z``.
        unit: rad or m.
        prior: Its standard deviation before any touch, rad or m.
        free: Whether it is estimated at all.
    """

    name: str
    unit: str
    prior: float
    free: bool


class Layout:
    """The vector (k,) of a touch-off: zeros, base, origins, then points nobody has measured.

    Args:
        chain: The arm as described.
        extent: What of it is estimated; the rest stays zero.
        points: Names of the points that nobody has measured.
    """

    def __init__(self, chain: Chain, extent: Extent, points: tuple[str, ...] = ()) -> None:
        self.chain, self.extent, self.points = chain, extent, points
        self.origins = movable_origins(chain)
        self.parameters = (*self._zeros(), *self._base(), *self._origins(), *self._points())
        self.prior = np.array([p.prior for p in self.parameters])
        self.free = np.array([p.free for p in self.parameters])

    @property
    def geometry_columns(self) -> slice:
        """Return where in the vector zeros, base and origins are, in the order of ``slopes``."""
        return slice(0, self.chain.dof + 6 + 3 * len(self.origins))

    def zeros(self, values: Vector) -> Vector:
        """Return what must be added to the joints (dof,)."""
        return values[: self.chain.dof]

    def geometry(self, values: Vector) -> Geometry:
        """Return how base and links differ."""
        n = self.chain.dof
        moves = values[n + 6 : n + 6 + 3 * len(self.origins)].reshape(-1, 3)
        origins = dict(zip(self.origins, moves, strict=True))
        return Geometry(values[n : n + 3], values[n + 3 : n + 6], origins)

    def point_columns(self) -> Mapping[str, slice]:
        """Return where in the vector each point that nobody has measured stands."""
        first = self.geometry_columns.stop
        return {p: slice(first + 3 * i, first + 3 * i + 3) for i, p in enumerate(self.points)}

    def _zeros(self) -> list[Parameter]:
        free = self.extent is not Extent.NOTHING
        turns = [kind is JointKind.REVOLUTE for kind in self.chain.kinds]
        return [
            Parameter(f"{name} zero", "rad", ZERO_RAD, free)
            if turn
            else Parameter(f"{name} zero", "m", ZERO_M, free)
            for name, turn in zip(self.chain.names, turns, strict=True)
        ]

    def _base(self) -> list[Parameter]:
        free = self.extent.base
        places = [Parameter(f"base {axis}", "m", BASE_M, free) for axis in "xyz"]
        return places + [Parameter(f"base about {a}", "rad", BASE_RAD, free) for a in "xyz"]

    def _origins(self) -> list[Parameter]:
        free = self.extent.links
        return [
            Parameter(f"{name} origin {axis}", "m", ORIGIN_M, free)
            for name in self.origins
            for axis in "xyz"
        ]

    def _points(self) -> list[Parameter]:
        names = (f"{point} {axis}" for point in self.points for axis in "xyz")
        return [Parameter(name, "m", POINT_M, True) for name in names]
