"""Identify motors, friction, masses and payload of an arm from recordings of its servos.

Torques are only as certain as the torque at full duty. Servos that measure their current determine
it, because duty, current and speed give the torque constant and the resistance (see
`lab.drive_fit`). For other servos, only the ratios of torques to it are determined, and its
nominal value sets the scale.

The parameters are those that explain the duties best (see `lab.duty_model`; nonlinear least squares
within physical bounds), with a normal prior on each (maximum a posteriori). Standard errors come
from the sandwich estimator of Liang and Zeger, "Longitudinal data analysis using generalized linear
models", 1986, clustered by leg of the motion, because neighbouring windows have similar errors. A
parameter whose error stays near its prior is not determined.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ikservo.apps.lab.drive_fit import (
    JointPrior,
    LoopFit,
    MotorConstants,
    fit_backlash,
    fit_loop,
    fit_motors,
    mean_duties,
    sign_currents,
)
from ikservo.apps.lab.drive_recording import Cube, DriveRecording, steady_windows
from ikservo.apps.lab.duty_model import (
    COMMON_SCALE,
    JOINT_PARAMETERS,
    DutyModel,
    ParameterPrior,
    nominal_prior,
)
from ikservo.errors import CalibrationError
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.dynamics import Dynamics

_N, _LOGARITHMIC = len(JOINT_PARAMETERS), (0, len(JOINT_PARAMETERS) - 1)
_DETERMINED = 0.5
"""A parameter is determined if its standard error is below this fraction of its prior error."""
_KEPT_ASIDE = 4  # every fourth pair of legs, there and back, is held out for validation
_MIN_WINDOWS = 12  # windows per joint
_BACKLASH_RAD = 0.02  # prior standard deviation
_TIGHT = 1e-3  # prior of a parameter that is not estimated


@dataclass(frozen=True, slots=True)
class ParameterEstimate:
    """One estimated parameter, its standard error, and its prior standard deviation."""

    value: float
    error: float
    error_before: float

    @property
    def determined(self) -> bool:
        """Whether the data add enough information to the prior."""
        return self.error < _DETERMINED * self.error_before


@dataclass(frozen=True, slots=True)
class Validation:
    """Errors of a joint's predicted lag behind its goals, on legs left out of the estimate.

    Attributes:
        identified: Root mean square error with the parameters estimated from the other legs, rad
            or m.
        nominal: Root mean square error with the parameters of the tables.
    """

    identified: float
    nominal: float

    @property
    def is_better(self) -> bool:
        """Whether the identified parameters predict better than the parameters from the tables."""
        return self.identified < self.nominal


@dataclass(frozen=True, slots=True, eq=False)
class Identification:
    """An identified arm.

    Attributes:
        joints: The joints of the chain.
        bodies: The bodies that the joints move.
        estimates: The estimates by name: ``JOINT.PARAMETER`` for `JOINT_PARAMETERS`,
            ``stiffness_nm_rad`` and ``backlash_rad``, all servos of the joint together, at the
            joint; ``BODY.mass_scale``; and ``payload_kg``. Parameters that were not measured are
            left out.
        motors: The motors of the joints whose servos measure their current.
        validation: The validation by joint. If identified parameters predict no better, the joint's
            estimates are the values of the tables.
    """

    joints: tuple[str, ...]
    bodies: tuple[str, ...]
    estimates: Mapping[str, ParameterEstimate]
    motors: Mapping[str, MotorConstants]
    validation: Mapping[str, Validation]

    def joint(self, name: str) -> Vector:
        """Compute the parameters of a joint, in the order of `JOINT_PARAMETERS`."""
        return np.array([self.estimates[f"{name}.{key}"].value for key in JOINT_PARAMETERS])

    @property
    def payload_kg(self) -> float:
        """Mass at the tip."""
        return self.estimates["payload_kg"].value


def gravity_columns(dynamics: Dynamics, q: Matrix) -> Cube:
    """Compute gravity torques (n, dof, bodies + 1) at q (n, dof): each body and a 1 kg payload."""
    zero, parameters = np.zeros_like(q), dynamics.parameters
    Y = dynamics.regressor(q, zero, zero) * parameters
    bodies = Y.reshape(*Y.shape[:2], len(dynamics.bodies), -1).sum(axis=3)
    payload = dynamics.with_parameters(np.zeros_like(parameters)).with_payload(1.0)
    return np.concatenate([bodies, payload.gravity_torques(q)[..., None]], axis=2)


def identify(
    dynamics: Dynamics, priors: Sequence[JointPrior], recording: DriveRecording
) -> Identification:
    """Identify the parameters that explain a recording of slow motion best.

    Raises:
        CalibrationError: A joint has not moved enough.
    """
    recording = sign_currents(recording, priors)
    model, loops, found = _make_model(dynamics, priors, recording)
    x, fitted = _solve(model)
    covariance = _sandwich(fitted, x)
    pairs = zip(dynamics.chain.names, found, strict=True)
    motors = {name: constants for name, constants in pairs if constants is not None}
    nominal = nominal_prior([(prior, None) for prior in priors], len(dynamics.bodies))
    validation = _validate(dynamics.chain.names, model, loops, nominal)
    for j, name in enumerate(dynamics.chain.names):
        if name not in validation or not validation[name].is_better:
            own = slice(_N * j, _N * (j + 1))
            x[own], covariance[own, own] = nominal.mean[own], np.diag(nominal.deviation[own] ** 2)
    estimates = _joint_estimates(dynamics.chain.names, x, covariance, nominal, loops, priors)
    gravity = gravity_columns(dynamics, recording.position) @ _scales(x, len(dynamics.bodies))
    for j, name in enumerate(dynamics.chain.names):
        if name in motors:
            backlash = fit_backlash(recording, j, gravity[:, j], motors[name])
            if backlash is not None:
                estimates[f"{name}.backlash_rad"] = ParameterEstimate(*backlash, _BACKLASH_RAD)
    estimates |= _mass_estimates(dynamics.bodies, x, covariance, model.prior)
    return Identification(
        joints=dynamics.chain.names,
        bodies=dynamics.bodies,
        estimates=estimates,
        motors=motors,
        validation=validation,
    )


def identify_payload(
    dynamics: Dynamics,
    priors: Sequence[JointPrior],
    recording: DriveRecording,
    known: Identification | None,
) -> ParameterEstimate:
    """Identify the mass at the tip, given the identification of the empty arm, if there is one.

    Raises:
        CalibrationError: A joint has not moved enough.
    """
    model, _, _ = _make_model(dynamics, priors, sign_currents(recording, priors))
    if known is not None:
        model = replace(model, prior=_known_prior(known, model.prior))
    x, fitted = _solve(model)
    error = float(np.sqrt(_sandwich(fitted, x)[-1, -1]))
    return ParameterEstimate(float(x[-1]), error, float(model.prior.deviation[-1]))


def _make_model(
    dynamics: Dynamics, priors: Sequence[JointPrior], recording: DriveRecording
) -> tuple[DutyModel, list[LoopFit], list[MotorConstants | None]]:
    """Return the model of a recording, and the control loop and motors of each joint."""
    windows = steady_windows(recording)
    for j, name in enumerate(dynamics.chain.names):
        if np.count_nonzero(windows.joint == j) < _MIN_WINDOWS:
            raise CalibrationError(
                f"{name} has moved too little to be identified.",
                "Give the arm more room: remove boxes and objects within its reach, or widen "
                "its limits.",
            )
    loops = [fit_loop(windows.of_joint(j), prior) for j, prior in enumerate(priors)]
    motors = [fit_motors(windows.of_joint(j), prior) for j, prior in enumerate(priors)]
    duties, gravity = mean_duties(windows, loops), gravity_columns(dynamics, windows.q)
    joints = list(zip(priors, motors, strict=True))
    return DutyModel.of(duties, gravity, joints), loops, motors


def _solve(model: DutyModel) -> tuple[Vector, DutyModel]:
    """Compute the parameters x; return them and the model with the measured noise."""
    from scipy.optimize import least_squares  # noqa: PLC0415  # slow to import, seldom needed

    prior = model.prior
    x = np.clip(prior.mean, prior.lower, prior.upper)
    for _ in range(2):
        solution = least_squares(
            model.residuals, x, model.jacobian, bounds=(prior.lower, prior.upper),
            x_scale=prior.deviation, loss="soft_l1",
        )  # fmt: skip
        x = np.asarray(solution.x, dtype=np.float64)
        model = model.with_noise(x)
    return x, model


def _sandwich(model: DutyModel, x: Vector) -> Matrix:
    """Compute the covariance of x; the residuals of one leg and joint are a group."""
    windows, J, residuals = model.windows, model.jacobian(x), model.residuals(x)
    H = np.linalg.pinv(J.T @ J, hermitian=True)
    rows = len(windows.joint)
    groups = windows.leg * (windows.joint.max() + 1) + windows.joint
    middle = J[rows:].T @ J[rows:]
    for group in np.unique(groups):
        mine: NDArray[np.bool_] = groups == group
        score = J[:rows][mine].T @ residuals[:rows][mine]
        middle = middle + np.outer(score, score)
    covariance: Matrix = H @ middle @ H
    return covariance


def _joint_estimates(
    joints: Sequence[str],
    x: Vector,
    covariance: Matrix,
    nominal: ParameterPrior,
    loops: Sequence[LoopFit],
    priors: Sequence[JointPrior],
) -> dict[str, ParameterEstimate]:
    """Return the parameters and the stiffness of each joint."""
    errors = np.sqrt(np.diag(covariance))
    estimates: dict[str, ParameterEstimate] = {}
    for k, (name, key) in enumerate((name, key) for name in joints for key in JOINT_PARAMETERS):
        value = float(np.exp(x[k]) if k % _N in _LOGARITHMIC else x[k])
        unit = value if k % _N in _LOGARITHMIC else 1.0
        estimates[f"{name}.{key}"] = ParameterEstimate(
            value, float(unit * errors[k]), float(unit * nominal.deviation[k])
        )
    # The stiffness is the torque at full duty times the duty per rad.
    for name, loop, prior in zip(joints, loops, priors, strict=True):
        full = estimates[f"{name}.full_duty_nm"]
        value = full.value * loop.duty_per_rad
        share = np.hypot(full.error / full.value, loop.duty_per_rad_error / loop.duty_per_rad)
        before = np.hypot(prior.full_duty_share, loop.share_before)
        estimates[f"{name}.stiffness_nm_rad"] = ParameterEstimate(
            value, float(value * share), float(value * before)
        )
    return estimates


def _scales(x: Vector, bodies: int) -> Vector:
    """Compute the scale of each body and the payload (bodies + 1,)."""
    scales: Vector = np.append(x[-bodies - 2] + x[-bodies - 1 : -1], x[-1])
    return scales


def _mass_estimates(
    bodies: Sequence[str], x: Vector, covariance: Matrix, prior: ParameterPrior
) -> dict[str, ParameterEstimate]:
    at, scales = len(x) - len(bodies) - 2, _scales(x, len(bodies))
    estimates: dict[str, ParameterEstimate] = {}
    for b, name in enumerate(bodies):
        k = at + 1 + b
        variance = covariance[at, at] + covariance[k, k] + 2.0 * covariance[at, k]
        before = np.hypot(COMMON_SCALE, prior.deviation[k])
        estimates[f"{name}.mass_scale"] = ParameterEstimate(
            float(scales[b]), float(np.sqrt(max(variance, 0.0))), float(before)
        )
    error, before = np.sqrt(covariance[-1, -1]), prior.deviation[-1]
    estimates["payload_kg"] = ParameterEstimate(float(x[-1]), float(error), float(before))
    return estimates


def _validate(
    joints: Sequence[str], model: DutyModel, loops: Sequence[LoopFit], nominal: ParameterPrior
) -> dict[str, Validation]:
    """Fit the model to some legs, and predict the legs that were left out."""
    aside = model.windows.leg // 2 % _KEPT_ASIDE == 1
    x, kept = _solve(model.only(~aside))[0], model.only(aside)
    found: dict[str, Validation] = {}
    errors = kept.errors_by_joint(x), kept.errors_by_joint(nominal.mean)
    for name, loop, own, tables in zip(joints, loops, *errors, strict=True):
        if len(own):
            lag, before = (np.sqrt(np.mean(e**2)) / loop.duty_per_rad for e in (own, tables))
            found[name] = Validation(float(lag), float(before))
    return found


def _known_prior(known: Identification, nominal: ParameterPrior) -> ParameterPrior:
    """Return the prior of an identified arm; its payload is unknown."""
    mean, deviation = nominal.mean.copy(), nominal.deviation.copy()
    keys = [(name, key) for name in known.joints for key in JOINT_PARAMETERS]
    for k, (name, key) in enumerate(keys):
        own = known.estimates[f"{name}.{key}"]
        logarithmic = k % _N in _LOGARITHMIC
        mean[k] = np.log(own.value) if logarithmic else own.value
        deviation[k] = own.error / own.value if logarithmic else own.error
    at = len(keys)
    mean[at], deviation[at] = 1.0, _TIGHT
    for b, name in enumerate(known.bodies):
        own = known.estimates[f"{name}.mass_scale"]
        mean[at + 1 + b], deviation[at + 1 + b] = own.value - 1.0, own.error
    floor = _TIGHT * nominal.deviation
    return ParameterPrior(mean, np.maximum(deviation, floor), nominal.lower, nominal.upper)
