"""How much of an arm some touches may change: only what helps on touches that were kept aside."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ikservo.errors import CalibrationError
from ikservo.kinematics import Chain
from ikservo.kinematics.geometry import Geometry
from ikservo.kinematics.se3 import Vector
from ikservo.model.touch.fit import Fit, Mask, fit, fit_robustly
from ikservo.model.touch.layout import Extent
from ikservo.model.touch.touches import Touch, unknown_points

__all__ = ["FEWEST", "Estimate", "estimate"]

FEWEST = 5
_FOLDS = 5
_BETTER = 0.95  # more of the arm is changed only where that takes a twentieth off the error
_WORTH = 0.9  # and nothing at all where it takes off less than a tenth
_LOOKS = 200  # postures at which it is asked how well the tip is known


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """What a touch-off found.

    Attributes:
        fit: The arm that fits all touches that were believed.
        aside_m: By extent, the root mean square error on touches while they were kept aside.
        deviation_m: How well the tip is known all over the joints' ranges: one standard
            deviation at the middle posture and at the nineteenth of twenty.
    """

    fit: Fit
    aside_m: dict[Extent, float]
    deviation_m: tuple[float, float]

    @property
    def extent(self) -> Extent:
        """Return what of the arm is changed."""
        return self.fit.layout.extent

    @property
    def before_m(self) -> float:
        """Return the error on touches kept aside if nothing is changed."""
        return self.aside_m[Extent.NOTHING]

    @property
    def after_m(self) -> float:
        """Return the error on touches while they were kept aside."""
        return self.aside_m[self.extent]

    @property
    def improves(self) -> bool:
        """Return whether there is anything to save."""
        return self.extent is not Extent.NOTHING

    @property
    def zeros(self) -> Vector:
        """Return what must be added to the joints (dof,), rad or m."""
        return self.fit.layout.zeros(self.fit.values)

    @property
    def geometry(self) -> Geometry:
        """Return how base and links differ."""
        return self.fit.layout.geometry(self.fit.values)


def estimate(chain: Chain, touches: Sequence[Touch], present: Chain | None = None) -> Estimate:
    """Work out what some touches say about an arm.

    Every touch is kept aside once while the others are fitted; from zeros alone to the whole arm,
    the extent is taken whose errors there are smallest, then all touches are fitted together.

    Args:
        chain: The arm as described.
        touches: What was touched.
        present: The arm as it is believed at present, if that is not as described: what has to
            be bettered.

    Raises:
        CalibrationError: Too few touches, or a third of them contradicts the others.
    """
    if len(touches) < FEWEST:
        raise CalibrationError(
            f"Too few touches: {len(touches)}; at least {FEWEST} are needed.",
            "Touch about 15 points, in different postures.",
        )
    extents = _extents(touches)
    kept = fit_robustly(chain, touches, extents[-1]).kept
    aside = {extent: _aside(chain, touches, extent, kept) for extent in extents}
    aside[Extent.NOTHING] = _aside(present or chain, touches, Extent.NOTHING, kept)
    chosen = _chosen(aside)
    found = fit(chain, touches, chosen, kept)
    return Estimate(found, aside, _deviation(found, chain))


def _extents(touches: Sequence[Touch]) -> list[Extent]:
    """Return what can be estimated at all, the least first: unmeasured points place no base."""
    if all(touch.position_m is None for touch in touches):
        return [Extent.NOTHING, Extent.ZEROS, Extent.LINKS]
    return [Extent.NOTHING, Extent.ZEROS, Extent.BASE, Extent.LINKS, Extent.EVERYTHING]


def _chosen(aside: dict[Extent, float]) -> Extent:
    best, *others = aside
    for extent in others:
        share = _WORTH if best is Extent.NOTHING else _BETTER
        if aside[extent] < share * aside[best]:
            best = extent
    return best


def _aside(chain: Chain, touches: Sequence[Touch], extent: Extent, kept: Mask) -> float:
    """Return the root mean square error on touches while they were kept aside."""
    folds = _folds(touches)
    squares: list[float] = []
    for fold in range(_FOLDS):
        rest = kept & (folds != fold)
        tested = [t for t, k, f in zip(touches, kept, folds, strict=True) if k and f == fold]
        if tested and rest.any():
            errors = fit(chain, touches, extent, rest).errors_m(tested)
            squares += (errors**2).tolist()
    return math.sqrt(sum(squares) / len(squares))


def _folds(touches: Sequence[Touch]) -> Vector:
    """Return which fifth (n,) each touch belongs to; a measured point's touches stay together."""
    unknown = unknown_points(touches)
    names = list(dict.fromkeys(touch.point for touch in touches))
    return np.array(
        [
            (i if touch.point in unknown else names.index(touch.point)) % _FOLDS
            for i, touch in enumerate(touches)
        ]
    )


def _deviation(found: Fit, chain: Chain) -> tuple[float, float]:
    chance = np.random.default_rng(0)
    low, high = np.maximum(chain.lower_rad, -math.pi), np.minimum(chain.upper_rad, math.pi)
    middle, most = np.percentile(
        found.deviation_m(chance.uniform(low, high, (_LOOKS, chain.dof))), [50, 95]
    )
    return float(middle), float(most)
