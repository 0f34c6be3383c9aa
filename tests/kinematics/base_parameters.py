"""Base parameters: the inertial parameters that the torques of a chain can determine.

Many parameters affect no torque (the mass of a body that turns about a fixed axis), or affect
torques only in combination with others. Their columns of the regressor Y are linear combinations of
other columns: ``Y = Y_b G`` with the independent columns Y_b, so that ``tau = Y p = Y_b (G p)``.
Least squares can find only the base parameters ``G p`` (Gautier, "Numerical calculation of the base
inertial parameters of robots", 1991).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ikservo.kinematics.arrays import IntVector, Matrix, Vector, read_only
from ikservo.kinematics.dynamics import Dynamics

# A parameter counts as without effect if its effect on the torques is a smaller fraction of the
# largest effect. On the arms of the catalogue, at rest or at 0.3 rad/s and more, relevant
# parameters have more than 5e-4; rounded angles in a file (1.5708) give others less than 3e-6.
_TOLERANCE = 3e-5
_ROUNDING = 1e-12  # fraction of the largest effect
_MOTIONS = 200  # random motions to evaluate

TYPICAL_PARAMETERS = read_only([1.0, *[0.1] * 3, *[0.01] * 6])
"""Typical sizes of the ten parameters per kg of a body that is about 0.1 m long."""


@dataclass(frozen=True, slots=True, eq=False)
class BaseParameters:
    """The independent columns of a regressor, and the combinations of parameters for them.

    Attributes:
        columns: The independent columns of the regressor (b,), ascending.
        combination: G (b, p), from parameters to base parameters; the identity in ``columns``.
    """

    columns: IntVector
    combination: Matrix

    def reduce(self, regressor: Matrix) -> Matrix:
        """Return the independent columns (…, b) of a regressor (…, p)."""
        return regressor[..., self.columns]

    def expand(self, base_values: ArrayLike) -> Vector:
        """Return parameters (p,) that give the torques of base parameters (b,).

        The other parameters are zero, so that the result does not describe real bodies.
        """
        parameters = np.zeros(self.combination.shape[1])
        parameters[self.columns] = base_values
        return parameters


def base_parameters(
    dynamics: Dynamics,
    *,
    speed_rad_s: float = 3.0,
    acceleration_rad_s2: float = 10.0,
    tolerance: float = _TOLERANCE,
    seed: int = 0,
) -> BaseParameters:
    """Return the base parameters of an arm from random motions inside its limits.

    Args:
        dynamics: The arm; only its geometry and gravity matter, not its parameters.
        speed_rad_s: Largest speed of the motions; m/s for prismatic joints.
        acceleration_rad_s2: Largest acceleration; m/s² for prismatic joints. With zero speed and
            acceleration, the result contains only what postures at rest determine.
        tolerance: See ``independent_columns``.
        seed: The seed of the random numbers; other motions give the same columns.
    """
    random, chain = np.random.default_rng(seed), dynamics.chain
    # A continuous joint may move by a full turn.
    low = np.where(np.isfinite(chain.lower_rad), chain.lower_rad, -np.pi)
    high = np.where(np.isfinite(chain.upper_rad), chain.upper_rad, np.pi)
    shape = (_MOTIONS, chain.dof)
    q = random.uniform(low, high, shape)
    qd = random.uniform(-speed_rad_s, speed_rad_s, shape)
    qdd = random.uniform(-acceleration_rad_s2, acceleration_rad_s2, shape)
    Y = dynamics.regressor(q, qd, qdd)
    typical = np.tile(TYPICAL_PARAMETERS, len(dynamics.bodies))
    return independent_columns(Y.reshape(-1, Y.shape[-1]), typical, tolerance)


def independent_columns(
    regressor: ArrayLike, typical: ArrayLike, tolerance: float = _TOLERANCE
) -> BaseParameters:
    """Return the columns of a stacked regressor that are independent of earlier columns.

    This is the method of Gautier 1991, with the parameters in their order: the parameters of a body
    are combined into those of the bodies that carry it. In the QR decomposition, R has the same
    lengths and angles of columns as the regressor, but no more rows than there are parameters.
    Additional columns, for friction or a scale of the current, may follow those of the inertia.

    Args:
        regressor: The regressor (m, p), one row per torque.
        typical: Size of each parameter (p,), so that effects on the torques can be compared.
        tolerance: Effect that a column must add to the earlier columns, relative to the largest
            effect of all columns. Torques of the reduced regressor are exact to this tolerance.
    """
    Y, sizes = np.asarray(regressor, dtype=float), np.asarray(typical, dtype=float)
    effects = np.linalg.qr(Y * sizes).R
    least = max(tolerance, _ROUNDING)
    columns = _select_columns(effects, least * np.linalg.norm(effects, axis=0).max(initial=0.0))
    G = np.linalg.lstsq(effects[:, columns], effects, rcond=None)[0] / sizes * sizes[columns, None]
    return BaseParameters(columns, read_only(G))


def _select_columns(Y: Matrix, least: float) -> IntVector:
    """Select the columns whose part that is independent of earlier columns exceeds ``least``."""
    basis = np.empty((0, len(Y)))
    columns: list[int] = []
    for column in range(Y.shape[1]):
        rest = Y[:, column] - basis.T @ (basis @ Y[:, column])
        length = float(np.linalg.norm(rest))
        if length > least:
            columns.append(column)
            basis = np.vstack([basis, rest / length])
    return np.array(columns, dtype=np.int64)
