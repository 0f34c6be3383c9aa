"""The most likely arm for some touches: least squares with priors, and no faith in outliers.

Minimises ``Σ ρ(|f(q_i + δ; g) - p_i|² / σ²) + Σ (x_k / σ_k)²`` over the vector x of zero errors δ,
geometry g and unmeasured points, where ρ grows like a logarithm for touches that went astray.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ikservo.errors import CalibrationError
from ikservo.kinematics import Chain
from ikservo.kinematics.geometry import slopes
from ikservo.kinematics.se3 import Matrix, Vector
from ikservo.model.touch.layout import Extent, Layout
from ikservo.model.touch.problem import TOUCH_M, Mask, Problem
from ikservo.model.touch.touches import Touch, joints_of

__all__ = ["Fit", "Mask", "fit", "fit_robustly"]

_MEDIAN_OF_CHI3 = 1.538  # the median length of three normal numbers
_STRAYS = 4.5  # such lengths further than a touch may be: one in a thousand good ones
_MOST_STRAYS = 1.0 / 3.0
_ROUNDS = 5
_WILDEST_M = 0.005


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """An arm that fits some touches.

    Attributes:
        layout: What the numbers mean.
        values: The vector (k,).
        covariance: How well it is known (k, k); zero for what was not estimated.
        scaled: Singular values, falling, of how the touches move with all that was estimated,
            each counted in its prior: above 1 the touches say more than was known before.
        kept: The touches (n,) that were believed.
        residuals_m: How far the tip was from each point (n,), left out ones included.
    """

    layout: Layout
    values: Vector
    covariance: Matrix
    scaled: Vector
    kept: Mask
    residuals_m: Vector

    def tips(self, q: Matrix) -> Matrix:
        """Return where the tip is (n, 3), metres, for joints (n, dof) as the arm says them."""
        geometry = self.layout.geometry(self.values)
        return slopes(self.layout.chain, q + self.layout.zeros(self.values), geometry, ())[0]

    def errors_m(self, touches: Sequence[Touch]) -> Vector:
        """Return how far the tip is from each touch's point (n,)."""
        return np.linalg.norm(self.tips(joints_of(touches)) - self._points(touches), axis=1)

    def deviation_m(self, q: Matrix) -> Vector:
        """Return how well the tip is known (n,) at joints (n, dof): one standard deviation."""
        layout, geometry = self.layout, self.layout.geometry(self.values)
        J = slopes(layout.chain, q, geometry, layout.origins)[1]
        C = self.covariance[layout.geometry_columns, layout.geometry_columns]
        variance = np.einsum("nik,kl,nil->n", J, C, J)
        return np.sqrt(np.maximum(variance, 0.0))

    def _points(self, touches: Sequence[Touch]) -> Matrix:
        columns = self.layout.point_columns()
        return np.array(
            [
                self.values[columns[t.point]] if t.position_m is None else t.position_m
                for t in touches
            ]
        )


def fit(chain: Chain, touches: Sequence[Touch], extent: Extent, kept: Mask) -> Fit:
    """Return the arm that fits the kept touches."""
    return _solved(Problem(chain, touches, extent), kept, robust=False)


def fit_robustly(chain: Chain, touches: Sequence[Touch], extent: Extent) -> Fit:
    """Return the arm that fits what most touches agree on, the others left out.

    Raises:
        CalibrationError: More than a third of the touches contradict the others, or all do.
    """
    problem = Problem(chain, touches, extent)
    everyone = np.ones(len(touches), dtype=np.bool_)
    found = _solved(problem, everyone, robust=True)
    for _ in range(_ROUNDS):
        kept = _credible(found)
        if np.count_nonzero(~kept) > _MOST_STRAYS * len(touches):
            raise _contradicting(touches, kept)
        found = _solved(problem, kept, robust=False)
    _refuse_scatter(found)
    return found


def _solved(problem: Problem, kept: Mask, *, robust: bool) -> Fit:
    from scipy.optimize import least_squares  # noqa: PLC0415  # slow to import, seldom needed

    x = problem.start
    if problem.layout.free.any():
        answer = least_squares(
            lambda x: problem.residuals(x, kept),
            x,
            lambda x: problem.jacobian(x, kept),
            x_scale=problem.prior,
            loss=partial(_logarithmic, 3 * int(np.count_nonzero(kept))) if robust else "linear",
        )
        x = np.asarray(answer.x, dtype=np.float64)
    return _fitted(problem, x, kept)


def _logarithmic(rows: int, squares: Vector, cost_only: bool | None = None) -> Matrix:
    """Return ρ, ρ' and ρ'' (3, m) of squared residuals (m,): log(1 + z) for the first ``rows``."""
    rho = np.array([squares, np.ones_like(squares), np.zeros_like(squares)])
    near = 1.0 / (1.0 + squares[:rows])
    rho[:, :rows] = -np.log(near), near, -(near**2)
    return rho


def _fitted(problem: Problem, x: Vector, kept: Mask) -> Fit:
    layout, J = problem.layout, problem.jacobian(x, kept)
    covariance = np.zeros((len(layout.free), len(layout.free)))
    if layout.free.any():
        covariance[np.ix_(layout.free, layout.free)] = np.linalg.inv(J.T @ J)
    told = J[: 3 * np.count_nonzero(kept)] * problem.prior
    scaled: Vector = np.linalg.svd(told, compute_uv=False).astype(np.float64)
    values = problem.values(x)
    residuals_m = np.linalg.norm(problem.gaps(values)[0], axis=1)
    return Fit(layout, values, covariance, scaled, kept, residuals_m)


def _credible(found: Fit) -> Mask:
    """Return the touches that are no further off than chance explains."""
    spread = float(np.median(found.residuals_m[found.kept])) / _MEDIAN_OF_CHI3
    return found.residuals_m <= _STRAYS * max(spread, TOUCH_M)


def _refuse_scatter(found: Fit) -> None:
    spread_m = float(np.median(found.residuals_m[found.kept]))
    if spread_m > _WILDEST_M:
        raise CalibrationError(
            f"The touches do not fit this arm: median residual {1000 * spread_m:.0f} mm.",
            "Check the place of the sheet, its print scale (100 %) and the order of the points. "
            "Nothing was saved.",
        )


def _contradicting(touches: Sequence[Touch], kept: Mask) -> CalibrationError:
    names = ", ".join(t.point for t, good in zip(touches, kept, strict=True) if not good)
    return CalibrationError(
        f"{np.count_nonzero(~kept)} of {len(touches)} touches are outliers: {names}.",
        "Check the place of the sheet and its print scale (100 %). Nothing was saved.",
    )
