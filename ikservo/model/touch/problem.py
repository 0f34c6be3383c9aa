"""The equations of a touch-off: residuals of touches and priors, and their slopes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ikservo.kinematics import Chain
from ikservo.kinematics.geometry import slopes
from ikservo.kinematics.se3 import Matrix, Vector
from ikservo.model.touch.layout import Extent, Layout
from ikservo.model.touch.touches import Touch, joints_of, unknown_points

__all__ = ["TOUCH_M", "Mask", "Problem"]

TOUCH_M = 0.0006
"""How far a careful hand is off a point, each axis, one standard deviation; a tick included."""

Mask = NDArray[np.bool_]


class Problem:
    """Touches against the vector of a layout, of which ``x`` is what is free.

    Attributes:
        layout: What the vector means.
        prior: Standard deviations (x,) of what is free, before any touch.
        start: Where the search for x begins: unmeasured points in the middle of their touches.
    """

    def __init__(self, chain: Chain, touches: Sequence[Touch], extent: Extent) -> None:
        self.layout = Layout(chain, extent, unknown_points(touches))
        self.prior: Vector = self.layout.prior[self.layout.free]
        self._touches, self._q = touches, joints_of(touches)
        columns = self.layout.point_columns()
        self._columns = [columns[t.point] if t.position_m is None else None for t in touches]
        here = [np.zeros(3) if t.position_m is None else t.position_m for t in touches]
        self._known = np.array(here)
        self._middle = self._points_seen()
        self.start: Vector = self._middle[self.layout.free]

    def values(self, x: Vector) -> Vector:
        """Return the whole vector (k,)."""
        values = np.zeros(len(self.layout.free))
        values[self.layout.free] = x
        return values

    def residuals(self, x: Vector, kept: Mask) -> Vector:
        """Return the gaps of the kept touches, then x against its prior, in deviations."""
        gaps = self.gaps(self.values(x))[0][kept].ravel() / TOUCH_M
        return np.concatenate([gaps, (x - self.start) / self.prior])

    def jacobian(self, x: Vector, kept: Mask) -> Matrix:
        """Return how the residuals move with x."""
        J = self.gaps(self.values(x))[1][kept][:, :, self.layout.free] / TOUCH_M
        return np.vstack([J.reshape(3 * len(J), len(x)), np.diag(1.0 / self.prior)])

    def gaps(self, values: Vector) -> tuple[Matrix, Matrix]:
        """Return tip less point (n, 3), metres, and how that moves with the vector (n, 3, k)."""
        layout = self.layout
        q, geometry = self._q + layout.zeros(values), layout.geometry(values)
        tips, moving = slopes(layout.chain, q, geometry, layout.origins)
        J = np.zeros((len(q), 3, len(values)))
        J[:, :, layout.geometry_columns] = moving
        gaps = tips - self._known
        for i, column in enumerate(self._columns):
            if column is not None:
                gaps[i] -= values[column]
                J[i, :, column] = -np.eye(3)
        return gaps, J

    def _points_seen(self) -> Vector:
        vector = np.zeros(len(self.layout.free))
        tips = self.layout.chain.forward(self._q)[:, :3, 3]
        for point, column in self.layout.point_columns().items():
            mine = [touch.point == point for touch in self._touches]
            vector[column] = tips[mine].mean(axis=0)
        return vector
