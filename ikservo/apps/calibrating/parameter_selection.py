"""Selection of geometric parameters by cross-validation of the fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ikservo.apps.calibrating.kinematic_calibration import (
    CalibrationFit,
    Mask,
    ParameterSet,
    TouchPoint,
    fit_parameters,
    fit_robustly,
    unknown_points,
)
from ikservo.errors import CalibrationError
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Vector
from ikservo.kinematics.geometric_errors import GeometricErrors

MIN_TOUCHES = 5
_FOLDS = 5
_BETTER = 0.95  # more parameters are estimated only if that reduces the error by 5 %
_MIN_IMPROVEMENT = 0.9  # parameters are estimated at all only if that reduces the error by 10 %
_SAMPLES = 200  # number of postures at which the deviation of the tip is evaluated


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationEstimate:
    """The result of a touch-off.

    Attributes:
        fit: The arm, fitted to all touches except outliers.
        cross_validation_rms_m: The root mean square error on touches that were left out of the fit,
            by extent.
        deviation_m: Standard deviation of the tip, median and 95th percentile over postures in the
            joints' ranges.
    """

    fit: CalibrationFit
    cross_validation_rms_m: dict[ParameterSet, float]
    deviation_m: tuple[float, float]

    @property
    def extent(self) -> ParameterSet:
        """The estimated parameters."""
        return self.fit.layout.extent

    @property
    def before_m(self) -> float:
        """The RMS error on held-out touches if nothing is changed, m."""
        return self.cross_validation_rms_m[ParameterSet.NONE]

    @property
    def after_m(self) -> float:
        """The RMS error on held-out touches after the fit, m."""
        return self.cross_validation_rms_m[self.extent]

    @property
    def improves(self) -> bool:
        """Whether estimated corrections reduce the held-out error, so that saving is useful."""
        return self.extent is not ParameterSet.NONE

    @property
    def zeros(self) -> Vector:
        """The corrections of the joints (dof,), rad or m."""
        return self.fit.layout.zeros(self.fit.values)

    @property
    def geometry(self) -> GeometricErrors:
        """The errors of base and links."""
        return self.fit.layout.geometry(self.fit.values)


def select_and_fit(
    chain: Chain, touches: Sequence[TouchPoint], present: Chain | None = None
) -> CalibrationEstimate:
    """Select the parameters that touches identify, and fit them.

    Every touch is held out once while the rest are fitted, for each set from zeros alone to the
    whole arm. The set with the smallest held-out error is selected and fitted to all touches. The
    new fit must have a smaller error than ``present``, the arm with its calibration so far.

    Raises:
        CalibrationError: Too few touches, or a third of them contradict the others.
    """
    if len(touches) < MIN_TOUCHES:
        text = f"Too few touches: {len(touches)}; at least {MIN_TOUCHES} are needed."
        raise CalibrationError(text, "Touch about 15 points, in different postures.")
    extents = list(ParameterSet)  # the smallest set first
    if all(touch.position_m is None for touch in touches):  # the base needs measured points
        extents = [ParameterSet.NONE, ParameterSet.ZEROS, ParameterSet.LINKS]
    kept = fit_robustly(chain, touches, extents[-1]).kept
    aside = {extent: _held_out_error_m(chain, touches, extent, kept) for extent in extents}
    aside[ParameterSet.NONE] = _held_out_error_m(present or chain, touches, ParameterSet.NONE, kept)
    best, *others = aside
    for extent in others:
        max_ratio = _MIN_IMPROVEMENT if best is ParameterSet.NONE else _BETTER
        if aside[extent] < max_ratio * aside[best]:
            best = extent
    found = fit_parameters(chain, touches, best, kept)
    low, high = np.maximum(chain.lower_rad, -math.pi), np.minimum(chain.upper_rad, math.pi)
    postures = np.random.default_rng(0).uniform(low, high, (_SAMPLES, chain.dof))
    median_m, percentile_95_m = np.percentile(found.deviation_m(postures), [50, 95])
    return CalibrationEstimate(found, aside, (float(median_m), float(percentile_95_m)))


def _held_out_error_m(
    chain: Chain, touches: Sequence[TouchPoint], extent: ParameterSet, kept: Mask
) -> float:
    """Compute the root mean square error on held-out touches."""
    unknown, names = unknown_points(touches), list(dict.fromkeys(t.point for t in touches))
    folds = np.array([  # all touches of a measured point share a fold
        (i if touch.point in unknown else names.index(touch.point)) % _FOLDS
        for i, touch in enumerate(touches)
    ])  # fmt: skip
    squares: list[float] = []
    for fold in range(_FOLDS):
        rest = kept & (folds != fold)
        tested = [t for t, k, f in zip(touches, kept, folds, strict=True) if k and f == fold]
        if tested and rest.any():
            errors = fit_parameters(chain, touches, extent, rest).errors_m(tested)
            squares += (errors**2).tolist()
    return math.sqrt(sum(squares) / len(squares))
