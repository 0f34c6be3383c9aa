"""Kinematic calibration: fit geometric errors to touched points by least squares.

Minimises ``Σ ρ(|f(q_i + δ; g) - p_i|² / σ²) + Σ (x_k / σ_k)²`` over the vector x of zero errors δ,
geometry g and unmeasured points, where ρ grows like a logarithm for outliers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ikservo.errors import CalibrationError
from ikservo.kinematics import Chain, JointType
from ikservo.kinematics.arrays import FrozenArrays, Matrix, Vector
from ikservo.kinematics.geometric_errors import (
    GeometricErrors,
    calibration_jacobian,
    identifiable_origins,
)


@dataclass(frozen=True, slots=True, eq=False)
class TouchPoint(FrozenArrays):
    """One touch of a point with the tip.

    Attributes:
        q: The measured joints (dof,), rad or m.
        point: The point's name.
        position_m: The position of the point (3,), metres, in the desired base frame; None for an
            unmeasured point that is touched several times.
    """

    q: Vector
    point: str
    position_m: Vector | None = None


def joint_matrix(touches: Sequence[TouchPoint]) -> Matrix:
    """Compute the joint vectors (n, dof)."""
    return np.array([touch.q for touch in touches])


def unknown_points(touches: Sequence[TouchPoint]) -> tuple[str, ...]:
    """Return the names of the unmeasured points, each once."""
    return tuple(dict.fromkeys(touch.point for touch in touches if touch.position_m is None))


# Prior standard deviations for a zero set by eye, printed links, and a sheet whose edge is
# aligned with the arm.
ZERO_RAD, ZERO_M = math.radians(3.0), 0.002
BASE_M, BASE_RAD = 0.004, math.radians(1.0)
ORIGIN_M = 0.0012
POINT_M = 0.1


class ParameterSet(Enum):
    """The estimated parameters of the arm."""

    NONE = "nothing"
    ZEROS = "zeros"
    BASE = "zeros and base"
    LINKS = "zeros and links"
    EVERYTHING = "zeros, base and links"

    @property
    def includes_base(self) -> bool:
        """Whether the base pose is estimated."""
        return self in (ParameterSet.BASE, ParameterSet.EVERYTHING)

    @property
    def includes_links(self) -> bool:
        """Whether link lengths are estimated."""
        return self in (ParameterSet.LINKS, ParameterSet.EVERYTHING)


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a touch-off.

    Attributes:
        name: The name, such as ``elbow_flex zero``, ``base x`` or ``elbow_flex origin z``.
        unit: rad or m.
        prior: The prior standard deviation, rad or m.
        free: Whether it is estimated.
    """

    name: str
    unit: str
    prior: float
    free: bool


class ParameterVector:
    """The parameter vector (k,) of a touch-off: zeros, base, origins, then unmeasured points.

    Args:
        chain: The arm as described.
        extent: The set of estimated parameters; all other parameters stay zero.
        points: Names of the unmeasured points.
    """

    def __init__(self, chain: Chain, extent: ParameterSet, points: tuple[str, ...] = ()) -> None:
        self.chain, self.extent, self.points = chain, extent, points
        self.origins = identifiable_origins(chain)
        has_base, has_links = extent.includes_base, extent.includes_links
        found: list[Parameter] = []
        for name, kind in zip(chain.names, chain.kinds, strict=True):
            unit, prior = ("rad", ZERO_RAD) if kind is JointType.REVOLUTE else ("m", ZERO_M)
            found.append(Parameter(f"{name} zero", unit, prior, extent is not ParameterSet.NONE))
        found += [Parameter(f"base {axis}", "m", BASE_M, has_base) for axis in "xyz"]
        found += [Parameter(f"base about {axis}", "rad", BASE_RAD, has_base) for axis in "xyz"]
        names = (f"{joint} origin {axis}" for joint in self.origins for axis in "xyz")
        found += [Parameter(name, "m", ORIGIN_M, has_links) for name in names]
        names = (f"{point} {axis}" for point in points for axis in "xyz")
        found += [Parameter(name, "m", POINT_M, True) for name in names]
        self.parameters = tuple(found)
        self.prior = np.array([p.prior for p in self.parameters])
        self.free = np.array([p.free for p in self.parameters])

    @property
    def geometry_columns(self) -> slice:
        """The slice of zeros, base and origins; columns as in ``calibration_jacobian``."""
        return slice(0, self.chain.dof + 6 + 3 * len(self.origins))

    def zeros(self, values: Vector) -> Vector:
        """Return the corrections of the joints (dof,)."""
        return values[: self.chain.dof]

    def geometry(self, values: Vector) -> GeometricErrors:
        """Return the errors of base and links."""
        n = self.chain.dof
        moves = values[n + 6 : n + 6 + 3 * len(self.origins)].reshape(-1, 3)
        origins = dict(zip(self.origins, moves, strict=True))
        return GeometricErrors(values[n : n + 3], values[n + 3 : n + 6], origins)

    def point_columns(self) -> Mapping[str, slice]:
        """Return the columns of each unmeasured point."""
        first = self.geometry_columns.stop
        return {p: slice(first + 3 * i, first + 3 * i + 3) for i, p in enumerate(self.points)}


TOUCH_M = 0.0006
"""Standard deviation of a touch by hand per axis, including one tick of the joints."""

Mask = NDArray[np.bool_]


class LeastSquaresProblem:
    """Least-squares problem of touches; ``x`` are the free parameters of a vector.

    Attributes:
        layout: The meaning of the vector.
        prior: Prior standard deviations (x,) of the free parameters.
        start: Initial value of x; unmeasured points start at the mean of their touches.
    """

    def __init__(self, chain: Chain, touches: Sequence[TouchPoint], extent: ParameterSet) -> None:
        self.layout = ParameterVector(chain, extent, unknown_points(touches))
        self.prior: Vector = self.layout.prior[self.layout.free]
        self._touches, self._q = touches, joint_matrix(touches)
        columns = self.layout.point_columns()
        self._columns = [columns[t.point] if t.position_m is None else None for t in touches]
        known = [np.zeros(3) if t.position_m is None else t.position_m for t in touches]
        self._known = np.array(known)
        self._middle = self._touched_points()
        self.start: Vector = self._middle[self.layout.free]

    def values(self, x: Vector) -> Vector:
        """Return the full vector (k,) for the free parameters x."""
        values = np.zeros(len(self.layout.free))
        values[self.layout.free] = x
        return values

    def residuals(self, x: Vector, kept: Mask) -> Vector:
        """Compute the errors of the kept touches and then of x, in standard deviations."""
        errors = self.tip_errors(self.values(x))[0][kept].ravel() / TOUCH_M
        return np.concatenate([errors, (x - self.start) / self.prior])

    def jacobian(self, x: Vector, kept: Mask) -> Matrix:
        """Compute the derivatives of the residuals with respect to x."""
        J = self.tip_errors(self.values(x))[1][kept][:, :, self.layout.free] / TOUCH_M
        return np.vstack([J.reshape(3 * len(J), len(x)), np.diag(1.0 / self.prior)])

    def tip_errors(self, values: Vector) -> tuple[Matrix, Matrix]:
        """Return tip minus point (n, 3), metres, and its Jacobian (n, 3, k) for ``values``."""
        layout = self.layout
        q, geometry = self._q + layout.zeros(values), layout.geometry(values)
        tips, moving = calibration_jacobian(layout.chain, q, geometry, layout.origins)
        J = np.zeros((len(q), 3, len(values)))
        J[:, :, layout.geometry_columns] = moving
        errors = tips - self._known
        for i, column in enumerate(self._columns):
            if column is not None:
                errors[i] -= values[column]
                J[i, :, column] = -np.eye(3)
        return errors, J

    def _touched_points(self) -> Vector:
        vector = np.zeros(len(self.layout.free))
        tips = self.layout.chain.forward(self._q)[:, :3, 3]
        for point, column in self.layout.point_columns().items():
            mine = [touch.point == point for touch in self._touches]
            vector[column] = tips[mine].mean(axis=0)
        return vector


_MEDIAN_OF_CHI3 = 1.538  # median length of a vector of three standard normal numbers
_OUTLIER_DEVIATIONS = 4.5  # one in a thousand good touches has a larger residual
_MAX_OUTLIER_FRACTION = 1.0 / 3.0
_MAX_ITERATIONS = 5
_MAX_OUTLIER_M = 0.005


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationFit(FrozenArrays):
    """An arm fitted to touches.

    Attributes:
        layout: The meaning of the parameters.
        values: The vector (k,).
        covariance: The covariance (k, k); zero for parameters that were not estimated.
        scaled: Singular values, descending, of the Jacobian of the touches with respect to all
            estimated parameters, each scaled by its prior. Touches add information if a value is
            above 1.
        kept: Whether each touch (n,) was used.
        residuals_m: Distance from the tip to each point (n,), outliers included.
    """

    layout: ParameterVector
    values: Vector
    covariance: Matrix
    scaled: Vector
    kept: Mask
    residuals_m: Vector

    def tips(self, q: Matrix) -> Matrix:
        """Compute the tip positions (n, 3), metres, for measured joints (n, dof)."""
        geometry = self.layout.geometry(self.values)
        return calibration_jacobian(
            self.layout.chain, q + self.layout.zeros(self.values), geometry, ()
        )[0]

    def errors_m(self, touches: Sequence[TouchPoint]) -> Vector:
        """Compute the distance from the tip to each touch's point (n,)."""
        return np.linalg.norm(
            self.tips(joint_matrix(touches)) - self._touched_points(touches), axis=1
        )

    def deviation_m(self, q: Matrix) -> Vector:
        """Compute the standard deviation of the tip (n,) at joints (n, dof)."""
        layout, geometry = self.layout, self.layout.geometry(self.values)
        J = calibration_jacobian(layout.chain, q, geometry, layout.origins)[1]
        C = self.covariance[layout.geometry_columns, layout.geometry_columns]
        variance = np.einsum("nik,kl,nil->n", J, C, J)
        return np.sqrt(np.maximum(variance, 0.0))

    def _touched_points(self, touches: Sequence[TouchPoint]) -> Matrix:
        columns = self.layout.point_columns()
        return np.array(
            [
                self.values[columns[t.point]] if t.position_m is None else t.position_m
                for t in touches
            ]
        )


def fit_parameters(
    chain: Chain, touches: Sequence[TouchPoint], extent: ParameterSet, kept: Mask
) -> CalibrationFit:
    """Fit the arm to the kept touches."""
    return _solve_parameters(LeastSquaresProblem(chain, touches, extent), kept, robust=False)


def fit_robustly(
    chain: Chain, touches: Sequence[TouchPoint], extent: ParameterSet
) -> CalibrationFit:
    """Fit the arm to the touches without the outliers.

    Raises:
        CalibrationError: More than a third of the touches contradict the others, or none fit.
    """
    problem = LeastSquaresProblem(chain, touches, extent)
    all_touches = np.ones(len(touches), dtype=np.bool_)
    found = _solve_parameters(problem, all_touches, robust=True)
    for _ in range(_MAX_ITERATIONS):
        # Keep the touches whose error can be explained by noise.
        spread = float(np.median(found.residuals_m[found.kept])) / _MEDIAN_OF_CHI3
        kept = found.residuals_m <= _OUTLIER_DEVIATIONS * max(spread, TOUCH_M)
        if np.count_nonzero(~kept) > _MAX_OUTLIER_FRACTION * len(touches):
            names = ", ".join(t.point for t, good in zip(touches, kept, strict=True) if not good)
            raise CalibrationError(
                f"{np.count_nonzero(~kept)} of {len(touches)} touches are outliers: {names}.",
                "Check where the sheet lies and its print scale (100 %). Nothing was saved.",
            )
        found = _solve_parameters(problem, kept, robust=False)
    spread_m = float(np.median(found.residuals_m[found.kept]))
    if spread_m > _MAX_OUTLIER_M:
        raise CalibrationError(
            f"The touches do not fit this arm: median residual {1000 * spread_m:.0f} mm.",
            "Check where the sheet lies, its print scale (100 %) and the order of the points. "
            "Nothing was saved.",
        )
    return found


def _solve_parameters(problem: LeastSquaresProblem, kept: Mask, *, robust: bool) -> CalibrationFit:
    from scipy.optimize import least_squares  # noqa: PLC0415  # slow to import, seldom needed

    x = problem.start
    if problem.layout.free.any():
        solution = least_squares(
            lambda x: problem.residuals(x, kept),
            x,
            lambda x: problem.jacobian(x, kept),
            x_scale=problem.prior,
            loss=partial(_cauchy_loss, 3 * int(np.count_nonzero(kept))) if robust else "linear",
        )
        x = np.asarray(solution.x, dtype=np.float64)
    layout, J = problem.layout, problem.jacobian(x, kept)
    covariance = np.zeros((len(layout.free), len(layout.free)))
    if layout.free.any():
        covariance[np.ix_(layout.free, layout.free)] = np.linalg.inv(J.T @ J)
    scaled_jacobian = J[: 3 * np.count_nonzero(kept)] * problem.prior
    scaled: Vector = np.linalg.svd(scaled_jacobian, compute_uv=False).astype(np.float64)
    values = problem.values(x)
    residuals_m = np.linalg.norm(problem.tip_errors(values)[0], axis=1)
    return CalibrationFit(layout, values, covariance, scaled, kept, residuals_m)


def _cauchy_loss(rows: int, squares: Vector, cost_only: bool | None = None) -> Matrix:
    """Return ρ, ρ' and ρ'' (3, m) of squared residuals (m,): log(1 + z) for the first ``rows``."""
    rho = np.array([squares, np.ones_like(squares), np.zeros_like(squares)])
    near = 1.0 / (1.0 + squares[:rows])
    rho[:, :rows] = -np.log(near), near, -(near**2)
    return rho
