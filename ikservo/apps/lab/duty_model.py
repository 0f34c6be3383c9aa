"""Model of joint duties in steady motion, as a function of the arm's parameters.

In steady slow motion the torque of a joint's motor balances gravity and friction (model m4 of
Duclusaud, Passault et al., "Extended Friction Models for the Physics Simulation of Servo
Actuators", 2024)::

    T u V / V0 - kb w = g(q) + kv w + sign(w) (kc + kl h + kq h² + exp(-|w| / ws) (ks + kls h))
    h = |T u V / V0 - kb w + g(q)|                                  load of the gears

with the duty u, the supply V and its nominal value V0, the speed w, the torque T at full duty and
the back-EMF kb; kq is taken from the tables. Gravity is ``g(q) = Σ_b s_b g_b(q) + m g_p(q)``, with
a scale s_b of the mass of each body and a payload m at the tip.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ikservo.apps.lab.drive_fit import JointPrior, MotorConstants
from ikservo.apps.lab.drive_recording import Cube, SteadyWindows
from ikservo.kinematics.arrays import Matrix, Vector

JOINT_PARAMETERS = (
    "full_duty_nm",
    "damping_nm_s",
    "coulomb_nm",
    "load",
    "slow_nm",
    "slow_load",
    "slow_rad_s",
)
"""The parameters of a joint: T, kb + kv, kc, kl, ks, kls, ws; see `model.joint_drive`."""

COMMON_SCALE, BODY_SCALE = 0.3, 0.08
"""Standard deviation of the scale of all masses, and of each body's difference from it."""
PAYLOAD_KG = 0.5
_N, _LOGARITHMIC = len(JOINT_PARAMETERS), (0, len(JOINT_PARAMETERS) - 1)
_DUTY_NOISE = 0.004  # noise of a window's mean, from whole ticks and counts
_LOAD_FRICTION, _MAX_LOAD_FRICTION = 0.1, 0.45
# Back-EMF is kt (kt / R): the torque at full duty gives kt / R to 5 %, and magnets differ by 10 %.
_DAMPING_SHARE = 0.15
_SENSOR_SHARE = 0.02  # relative error of current and voltage sensors
_STEP = 1e-4  # step of numerical derivatives


@dataclass(frozen=True, slots=True, eq=False)
class ParameterPrior:
    """Prior of the parameters x: means, standard deviations and bounds.

    x are the `JOINT_PARAMETERS` of each joint, with logarithms of the first and the last, then the
    common scale of all masses, each body's difference from it, and the payload [kg].
    """

    mean: Vector
    deviation: Vector
    lower: Vector
    upper: Vector


@dataclass(frozen=True, slots=True, eq=False)
class DutyModel:
    """Residuals of the duties and of the prior, as functions of the parameters x.

    Attributes:
        windows: Windows of steady motion.
        gravity: Gravity torques of each window's own joint (k, bodies + 1): of each body, and of a
            payload of 1 kg.
        prior: The prior.
        back_emf_nm_s: Back-EMF of each joint (dof,); infinite if all damping counts as back-EMF.
        nominal_v: Supply of each joint's servos (dof,).
        square_per_nm: Friction per squared load of each joint's gears (dof,).
        noise: Standard deviation of the duties of each joint (dof,).
    """

    windows: SteadyWindows
    gravity: Matrix
    prior: ParameterPrior
    back_emf_nm_s: Vector
    nominal_v: Vector
    square_per_nm: Vector
    noise: Vector

    @classmethod
    def of(
        cls,
        windows: SteadyWindows,
        gravity: Cube,
        joints: Sequence[tuple[JointPrior, MotorConstants | None]],
        prior: ParameterPrior | None = None,
    ) -> DutyModel:
        """Return the model of an arm from windows of steady motion.

        ``gravity`` has the torques at each window's posture (k, dof, bodies + 1). Without
        ``prior``, the prior is derived from the priors of the joints.
        """
        own = gravity[np.arange(len(windows.joint)), windows.joint]
        return cls(
            windows=windows,
            gravity=own,
            prior=prior or nominal_prior(joints, gravity.shape[2] - 1),
            back_emf_nm_s=np.array([m.back_emf_nm_s if m else np.inf for _, m in joints]),
            nominal_v=np.array([known.nominal_v for known, _ in joints]),
            square_per_nm=np.array(
                [known.servo.friction.square_per_nm / known.force for known, _ in joints]
            ),
            noise=np.full(len(joints), _DUTY_NOISE),
        )

    def only(self, mask: NDArray[np.bool_]) -> DutyModel:
        """Return the model of the selected windows."""
        return replace(self, windows=self.windows.where(mask), gravity=self.gravity[mask])

    def with_noise(self, x: Vector) -> DutyModel:
        """Return the model with the measured duty noise of each joint that moved."""
        pairs = zip(self.errors_by_joint(x), self.noise, strict=True)
        found = np.array([np.sqrt(np.mean(r**2)) if len(r) else old for r, old in pairs])
        return replace(self, noise=np.maximum(found, 0.5 * _DUTY_NOISE))

    def duties(self, x: Vector) -> Vector:
        """Return the duty (k,) that each window needs."""
        return self._duties_under(x, self._gravity(x))

    def _duties_under(self, x: Vector, g: Vector) -> Vector:
        w, joints = self.windows, self.windows.joint
        P = x[: _N * len(self.noise)].reshape(-1, _N)[joints].T
        full, drag, kc, kl, ks, kls, ws = np.exp(P[0]), *P[1:6], np.exp(P[6])
        brake = np.minimum(self.back_emf_nm_s[joints], drag)
        sign, fade = np.sign(w.speed), np.exp(-np.abs(w.speed) / ws)
        steady = 2.0 * g + (drag - brake) * w.speed + sign * (kc + fade * ks)
        # With friction the load h solves t kq h² - (1 - t k) h + |steady| = 0, where t is 1 if
        # friction adds to it and -1 if friction reduces it.
        t, square = sign * np.sign(steady), self.square_per_nm[joints]
        rest = 1.0 - t * (kl + fade * kls)
        root = np.sqrt(np.maximum(rest**2 - 4.0 * t * square * np.abs(steady), 0.0))
        load = 2.0 * steady / (rest + root)
        volts = self.nominal_v[joints] / w.voltage_v[:, 0]
        return (load - g + brake * w.speed) / full * volts

    def residuals(self, x: Vector) -> Vector:
        """Compute the weighted residuals of the duties, then the residuals of the prior."""
        w = self.windows
        return np.concatenate(
            [
                (self.duties(x) - w.joint_duty) / self.noise[w.joint],
                (x - self.prior.mean) / self.prior.deviation,
            ]
        )

    def jacobian(self, x: Vector) -> Matrix:
        """Compute the derivative of the residuals; a window depends on its joint and on gravity."""
        w, joints = self.windows, len(self.noise)
        rows, at = np.arange(len(w.joint)), _N * joints
        J = np.zeros((len(rows), len(x)))
        start, g = self.duties(x), self._gravity(x)
        for p in range(_N):
            step = _STEP * self.prior.deviation[p:at:_N]
            moved = x.copy()
            moved[p:at:_N] += step
            J[rows, p + _N * w.joint] = (self.duties(moved) - start) / step[w.joint]
        by_gravity = (self._duties_under(x, g + _STEP) - start) / _STEP
        columns = by_gravity[:, None] * self.gravity
        J[:, at] = columns[:, :-1].sum(axis=1)
        J[:, at + 1 :] = columns
        return np.vstack([J / self.noise[w.joint][:, None], np.diag(1.0 / self.prior.deviation)])

    def _gravity(self, x: Vector) -> Vector:
        at = _N * len(self.noise)
        return self.gravity @ np.append(x[at] + x[at + 1 : -1], x[-1])

    def errors_by_joint(self, x: Vector) -> list[Vector]:
        """Return the errors of the duties, grouped by joint."""
        w = self.windows
        errors = self.duties(x) - w.joint_duty
        return [errors[w.joint == j] for j in range(len(self.noise))]


def nominal_prior(
    joints: Sequence[tuple[JointPrior, MotorConstants | None]], bodies: int
) -> ParameterPrior:
    """Return the prior of an arm from its files and the tables of its servos."""
    rows = [row for joint in joints for row in _joint_prior(*joint)]
    rows += [(1.0, COMMON_SCALE, 0.05, 5.0)]
    rows += [(0.0, BODY_SCALE, -0.9, 5.0)] * bodies + [(0.0, PAYLOAD_KG, 0.0, 20.0)]
    return ParameterPrior(*np.array(rows).T)


def _joint_prior(
    prior: JointPrior, motors: MotorConstants | None
) -> list[tuple[float, float, float, float]]:
    """Return the mean, deviation and bounds of a joint's parameters."""
    force, gears = prior.force, prior.servo.friction
    full, share = np.log(prior.full_duty_nm), prior.full_duty_share
    damping_nm_s = prior.servo.damping_nm_s * force / prior.per_horn_rad
    damping = (damping_nm_s, _DAMPING_SHARE * damping_nm_s)
    if motors is not None:
        own_share = float(np.hypot(_SENSOR_SHARE, motors.full_duty_error))
        weight = share**2 / (share**2 + own_share**2)
        full += weight * (np.log(motors.full_duty_nm) - full)
        share *= np.sqrt(1.0 - weight)
        damping = (1.05 * motors.back_emf_nm_s, 0.1 * motors.back_emf_nm_s)
    static = gears.static_nm * force
    slow_rad_s = gears.slow_rad_s * prior.per_horn_rad
    return [
        (full, share, full - 1.0, full + 1.0),
        (*damping, 0.0, 10.0 * damping[0]),
        (gears.coulomb_nm * force, 0.6 * static, 0.0, prior.full_duty_nm),
        (gears.load, _LOAD_FRICTION, 0.0, _MAX_LOAD_FRICTION),
        (gears.slow_nm * force, 0.4 * static, 0.0, prior.full_duty_nm),
        (gears.slow_load, _LOAD_FRICTION, 0.0, _MAX_LOAD_FRICTION),
        (np.log(slow_rad_s), 0.7, np.log(0.03), np.log(6.0)),
    ]
