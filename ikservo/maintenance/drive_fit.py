"""Motors, position loops and backlash of single joints, from steady motion and its reversals.

A servo that measures its current says what its motor is: ``u V = R i + kt w``, with the duty u, the
supply V and the speed w, has the resistance R and the torque constant kt, which is also the
back-EMF. Its position loop is a spring to the goal: ``u = k (e - d w) + u0 sign(e)`` with the error
e and the start-up force u0; d is what the D gain does between two goals, and delays. The speed of
the motor by its back-EMF less that of the joint is what the gears lose in their backlash.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ikservo.kinematics.arrays import Vector
from ikservo.maintenance.drive_recording import DriveRecording, SteadyWindows
from ikservo.model.servo_torque import ServoTorque

__all__ = [
    "JointPrior",
    "LoopFit",
    "MotorConstants",
    "fit_backlash",
    "fit_loop",
    "fit_motors",
    "mean_duties",
]

_CLEAR_SHARE = 0.1  # of the voltages: less does not say in which direction the current flows
# Errors of a window's volts: counts of the duty, and steps of the supply's reading, which windows
# alike share: they count as no more than this many.
_VOLTS, _SUPPLY_VOLTS, _MIN_WINDOWS = 0.01, 0.03, 10
_NOMINAL_SHARE = 0.1  # by which a servo's winding and magnets may differ from its model's
# By which the duty of a rad may differ from the firmware's, and where its gain was not read.
_KNOWN_GAIN_SHARE, _GAIN_SHARE = 0.02, 0.3
_DELAY_S, _DELAY_DEVIATION_S = 0.0, 0.03
_LOOP_NOISE = 0.004  # of a window's mean duty, at least
_NOISY_DUTY = 0.015  # of a window's mean: by more, duties say less than leads do
_NOISE_ROUNDS = 3  # in which the noise is found
# A joint whose gravity torque is below this share of that of the whole duty has its gears free.
_FREE_SHARE = 0.02
_REVERSAL_RAD = 0.06  # of the joint, in which its gears have crossed their backlash
_MIN_REVERSALS = 2
_MAX_BACKLASH_RAD = 0.2
_MIN_BACKLASH_ERROR_RAD = 0.001  # a tick


@dataclass(frozen=True, slots=True)
class JointPrior:
    """What is known of a joint's drive before: of its servos' models.

    Attributes:
        servo: Of one of its servos.
        servos: How many drive it.
        nominal_v: The supply of these figures.
        per_horn_rad: Motion of the joint for each rad of the horns.
        full_duty_share: Standard deviation of the torque of the whole duty, as a share of it.
        gain: The P gain in force, as a share of the servo's; None where it was not read.
    """

    servo: ServoTorque
    servos: int
    nominal_v: float
    per_horn_rad: float = 1.0
    full_duty_share: float = 0.05
    gain: float | None = 1.0

    @property
    def full_duty_nm(self) -> float:
        """Return the torque of the whole duty of all servos, at the joint."""
        return self.force * self.servo.full_duty_nm

    @property
    def force(self) -> float:
        """Return the torque at the joint for each N m at the horn of each servo."""
        return self.servos / self.per_horn_rad


@dataclass(frozen=True, slots=True)
class MotorConstants:
    """Motors of all servos of a joint together, at the joint, by duty, current and speed.

    Attributes:
        full_duty_nm: Torque of the whole duty at the nominal supply.
        back_emf_nm_s: kb.
        full_duty_error: Standard error of the first, as a share of it.
    """

    full_duty_nm: float
    back_emf_nm_s: float
    full_duty_error: float


@dataclass(frozen=True, slots=True)
class LoopFit:
    """The position loop of a joint's servos.

    Attributes:
        duty_per_rad: Duty for each rad (m) between goal and joint.
        duty_per_rad_error: Its standard error.
        share_before: Its standard deviation before, as a share of it.
        startup_duty: Duty that is added in the direction of the error.
        delay_s: By which the duty seems to be that of an earlier position: d.
        noise: By how much the duty of a window differs from that, rms: what the D gain does with
            the steps of the goals and of the position.
    """

    duty_per_rad: float
    duty_per_rad_error: float
    share_before: float
    startup_duty: float
    delay_s: float = 0.0
    noise: float = 0.0


def fit_motors(windows: SteadyWindows, prior: JointPrior) -> MotorConstants | None:
    """Return the motors of a joint; None where one of its servos does not measure its current.

    Args:
        windows: Of the joint.
        prior: Of its servos. Where a servo measures only the size of its current, the nominal
            motor says in which direction it flows.
    """
    found = [_winding(windows, k, prior) for k in range(prior.servos)]
    fits = [each for each in found if each is not None]
    if len(fits) < len(found):
        return None
    kt, R, shares = np.array(fits).T
    return MotorConstants(
        full_duty_nm=float((kt * prior.nominal_v / R).sum() / prior.per_horn_rad),
        back_emf_nm_s=float((kt * kt / R).sum() / prior.per_horn_rad**2),
        full_duty_error=float(np.sqrt((shares**2).sum()) / len(fits)),
    )


def _winding(
    windows: SteadyWindows, servo: int, prior: JointPrior
) -> tuple[float, float, float] | None:
    """Return kt, R and the standard error of kt / R, as a share of it, of one servo's motor."""
    current, speed = windows.current_a[:, servo], windows.speed / prior.per_horn_rad
    duty = windows.duty[:, servo]
    volts = duty * windows.voltage_v[:, servo]
    kt = prior.servo.damping_nm_s * prior.nominal_v / prior.servo.full_duty_nm
    nominal = np.array([kt * prior.nominal_v / prior.servo.full_duty_nm, kt])
    driving = volts - kt * speed
    clear = np.abs(driving) > _CLEAR_SHARE * (np.abs(kt * speed) + np.abs(volts))
    if (current >= 0.0).all():
        current = np.copysign(current, driving)
    used = np.isfinite(current) & clear
    count = np.count_nonzero(used)
    if count < _MIN_WINDOWS:
        return None
    noise = np.hypot(_VOLTS, _SUPPLY_VOLTS * duty[used]) * np.sqrt(count / _MIN_WINDOWS)
    A = np.vstack([
        np.column_stack([current, speed])[used] / noise[:, None],
        np.diag(1.0 / (_NOMINAL_SHARE * nominal)),
    ])  # fmt: skip
    (R, kt), *_ = np.linalg.lstsq(
        A, np.append(volts[used] / noise, [1.0 / _NOMINAL_SHARE] * 2), rcond=None
    )
    if R <= 0.0 or kt <= 0.0:
        return None
    gradient = np.array([-1.0 / R, 1.0 / kt])  # of log(kt / R)
    return float(kt), float(R), float(np.sqrt(gradient @ np.linalg.inv(A.T @ A) @ gradient))


def fit_loop(windows: SteadyWindows, prior: JointPrior) -> LoopFit:
    """Return the position loop of a joint from its windows."""
    servo, lead, speed = prior.servo, windows.lead, windows.speed
    share = _KNOWN_GAIN_SHARE if prior.gain else _GAIN_SHARE
    k = (prior.gain or 1.0) * servo.stiffness_nm_rad / servo.full_duty_nm / prior.per_horn_rad
    before = np.array([k, k * _DELAY_S, servo.startup_duty])
    deviations = np.array([
        share * k, k * _DELAY_DEVIATION_S, 0.3 * servo.startup_duty + 1e-4
    ])  # fmt: skip
    alike = np.sqrt(max(len(lead) / _MIN_WINDOWS, 1.0))
    columns = np.column_stack([lead, -speed, np.sign(lead)])
    found, residual = before, 0.0
    information = np.diag(deviations**-2.0)
    for _ in range(_NOISE_ROUNDS):
        noise = alike * max(residual, _LOOP_NOISE)
        A = np.vstack([columns / noise, np.diag(1.0 / deviations)])
        data = np.append(windows.joint_duty / noise, before / deviations)
        found, *_ = np.linalg.lstsq(A, data, rcond=None)
        residual = float(np.sqrt(np.mean((windows.joint_duty - columns @ found) ** 2)))
        information = A.T @ A
    error = np.sqrt(np.linalg.inv(information)[0, 0])
    k, from_delay, startup = found.tolist()
    return LoopFit(k, float(error), share, startup, from_delay / k, residual)


def mean_duties(windows: SteadyWindows, loops: Sequence[LoopFit]) -> SteadyWindows:
    """Return windows with the duties in the mean over time, which balance friction and load.

    Servos are read at some times between two goals. There the D gain brakes the joint; with each
    goal it drives it on by as much, in a moment that is hardly ever read. And the error falls from
    goal to goal. Where that makes the duties noisy, those that follow from the leads are taken.

    Args:
        windows: As read.
        loops: The loop of each joint.
    """
    duty = windows.duty.copy()
    for joint, loop in enumerate(loops):
        mine, k = windows.of_joint(joint), loop.duty_per_rad
        if loop.noise > _NOISY_DUTY:
            lead = mine.lead + mine.goal_age_s * mine.speed
            added = k * lead + loop.startup_duty * np.sign(lead) - mine.joint_duty
        else:
            added = k * (loop.delay_s + mine.goal_age_s) * mine.speed
        duty[windows.joint == joint] += added[:, None]
    return replace(windows, duty=duty)


def fit_backlash(
    recording: DriveRecording, joint: int, gravity: Vector, motors: MotorConstants | None,
    prior: JointPrior,
) -> tuple[float, float] | None:  # fmt: skip
    """Return the backlash of a joint and its standard error, rad; None where it does not show.

    It shows where the joint reverses and no load keeps its gears on one side, and its servo
    measures its current.

    Args:
        recording: Of the motion.
        joint: The joint.
        gravity: Its gravity torque in each sample (m,), as far as known.
        motors: Of its servos; None where they do not measure their current.
        prior: Of its servos.
    """
    if motors is None or np.abs(gravity).max() > _FREE_SHARE * motors.full_duty_nm:
        return None
    starts = _reversals(recording, joint)
    lost = np.array([_lost_motion(recording, joint, start, motors, prior) for start in starts])
    if len(lost) < _MIN_REVERSALS:
        return None
    spread = float(np.median(np.abs(lost - np.median(lost)))) * 1.48
    value = float(np.clip(np.median(lost), 0.0, _MAX_BACKLASH_RAD))
    return value, float(spread / np.sqrt(len(lost)) + _MIN_BACKLASH_ERROR_RAD)


def _reversals(recording: DriveRecording, joint: int) -> list[slice]:
    """Return the samples from each start of a leg in the other direction on."""
    found: list[slice] = []
    direction = 0.0
    for leg in np.unique(recording.leg):
        samples = np.flatnonzero(recording.leg == leg)
        goals = recording.goal[samples, joint]
        way = goals[-1] - goals[0]
        if abs(way) < 2.0 * _REVERSAL_RAD:
            direction = 0.0 if way else direction
            continue
        at = recording.position[samples, joint]
        beyond = np.flatnonzero(np.abs(at - at[0]) > _REVERSAL_RAD)
        if direction * way < 0.0 and len(beyond):
            found.append(slice(int(samples[0]), int(samples[beyond[0]]) + 1))
        direction = way
    return found


def _lost_motion(
    recording: DriveRecording, joint: int, samples: slice, motors: MotorConstants, prior: JointPrior
) -> float:
    """Return by how much the motor turns further than the joint, rad at the joint."""
    duty, volts = recording.duty[samples, joint, 0], recording.voltage_v[samples, joint, 0]
    kt = motors.back_emf_nm_s * prior.nominal_v / motors.full_duty_nm * prior.per_horn_rad
    R = kt * prior.nominal_v * prior.force / motors.full_duty_nm
    current = np.copysign(recording.current_a[samples, joint, 0], duty)
    speed = (duty * volts - R * current) / kt * prior.per_horn_rad
    turned = np.trapezoid(speed, recording.time_s[samples])
    position = recording.position[samples, joint]
    moved = float(position[-1] - position[0])
    return float(np.sign(moved) * (turned - moved))
