"""Motors, position loops and backlash of single joints, from steady motion and from swings.

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
from numpy.typing import NDArray

from ikservo.kinematics.arrays import Vector
from ikservo.lab.drive_recording import DriveRecording, SteadyWindows
from ikservo.model.servo_torque import ServoTorque

__all__ = [
    "JointPrior",
    "LoopFit",
    "MotorConstants",
    "fit_backlash",
    "fit_loop",
    "fit_motors",
    "mean_duties",
    "sign_currents",
]

# Errors of a window's volts: counts of the duty, and steps of the supply's reading, which windows
# alike share: they count as no more than this many.
_VOLTS, _SUPPLY_VOLTS, _MIN_WINDOWS = 0.01, 0.03, 10
# A window in which gears cross their backlash has another speed of the motor than of the joint: it
# differs by more than this many of those errors, and than this many times as much as most windows.
# Where more than half of the windows do, the joint swings by itself.
_SWINGING, _OUTLIER = 3.0, 4.0
_TRIMMING_ROUNDS = 4  # in which the windows that differ are found
_NOMINAL_SHARE = 0.1  # by which a servo's winding and magnets may differ from its model's
# By which the duty of a rad may differ from the firmware's, and where its gain was not read.
_KNOWN_GAIN_SHARE, _GAIN_SHARE = 0.02, 0.3
_DELAY_S, _DELAY_DEVIATION_S = 0.0, 0.03
_LOOP_NOISE = 0.004  # of a window's mean duty, at least
_NOISY_DUTY = 0.015  # of a window's mean: by more, duties say less than leads do
_NOISE_ROUNDS = 3  # in which the noise is found
_MOVING_RAD_S, _MIN_SWINGS = 0.05, 4
# A joint whose gravity torque is below this share of that of the whole duty has its gears free.
_FREE_SHARE = 0.01
_MIDDLE, _TINY = 0.2, 1e-9  # of a swing, to both sides of its middle
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
        """The torque of the whole duty of all servos, at the joint."""
        return self.force * self.servo.full_duty_nm

    @property
    def kt(self) -> float:
        """The torque constant of one of its motors, N m/A at the horn."""
        return self.servo.damping_nm_s * self.nominal_v / self.servo.full_duty_nm

    @property
    def force(self) -> float:
        """The torque at the joint for each N m at the horn of each servo."""
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
    """Fit the motors of a joint; None where one of its servos does not measure its current.

    Args:
        windows: Of the joint; its currents have a direction.
        prior: Of its servos.
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
    """Return kt, R and the standard error of kt / R, as a share of it, of one servo's motor.

    While gears cross their backlash the motor has another speed than the joint. Windows of that are
    left out; a joint that swings in its backlash has too few others, and its motor is the nominal.
    """
    current = windows.current_a[:, servo]
    used = np.isfinite(current)
    if np.count_nonzero(used) < _MIN_WINDOWS:
        return None
    duty = windows.duty[used, servo]
    volts = duty * windows.voltage_v[used, servo]
    noise = np.hypot(_VOLTS, _SUPPLY_VOLTS * duty)
    causes = np.column_stack([current, windows.speed / prior.per_horn_rad])[used] / noise[:, None]
    nominal = np.array([prior.kt * prior.nominal_v / prior.servo.full_duty_nm, prior.kt])
    known = np.diag(1.0 / (_NOMINAL_SHARE * nominal))
    found, A, residuals = nominal, known, np.zeros(len(volts))
    for _ in range(_TRIMMING_ROUNDS):
        kept = residuals <= max(_SWINGING, _OUTLIER * float(np.median(residuals)))
        alike = np.sqrt(_MIN_WINDOWS / np.count_nonzero(kept))
        A = np.vstack([alike * causes[kept], known])
        data = np.append(alike * (volts / noise)[kept], [1.0 / _NOMINAL_SHARE] * 2)
        found, *_ = np.linalg.lstsq(A, data, rcond=None)
        residuals = np.abs(volts / noise - causes @ found)
    if np.median(residuals) > _SWINGING:
        found, A = nominal, known
    R, kt = found.tolist()
    if R <= 0.0 or kt <= 0.0:
        return None
    gradient = np.array([-1.0 / R, 1.0 / kt])  # of log(kt / R)
    return kt, R, float(np.sqrt(gradient @ np.linalg.inv(A.T @ A) @ gradient))


def fit_loop(windows: SteadyWindows, prior: JointPrior) -> LoopFit:
    """Fit the position loop of a joint from its windows."""
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


def sign_currents(recording: DriveRecording, priors: Sequence[JointPrior]) -> DriveRecording:
    """Return a recording whose currents have a direction where servos measure only their size.

    Of the two it is the one in which the motor's speed by its back-EMF is nearer to the joint's:
    gears lose only a short way in their backlash.

    Args:
        recording: As read.
        priors: What is known of each joint's servos.
    """
    current = recording.current_a.copy()
    for j, prior in enumerate(priors):
        speed = np.gradient(recording.position[:, j], recording.time_s) / prior.per_horn_rad
        driving = (recording.duty * recording.voltage_v)[:, j] - prior.kt * speed[:, None]
        sizes = (current[:, j] >= 0.0).all(axis=0)
        current[:, j] = np.where(sizes, np.copysign(current[:, j], driving), current[:, j])
    return replace(recording, current_a=current)


def fit_backlash(
    recording: DriveRecording, joint: int, gravity: Vector, motors: MotorConstants,
    prior: JointPrior,
) -> tuple[float, float] | None:  # fmt: skip
    """Fit the backlash of a joint and its standard error, rad; None where it does not show.

    Where it swings by itself, nearly without load, its gears cross their backlash: pushed one way
    the motor is ahead of the joint, pushed the other way behind it. Where the joint passes the same
    place both ways, errors of kt cancel.

    Args:
        recording: Of the motion; its currents have a direction.
        joint: The joint.
        gravity: Its gravity torque in each sample (m,), as far as known: one that keeps its sign
            keeps the gears on one side.
        motors: Of its servos.
        prior: Of its servos.
    """
    swings = _swings(recording, joint)
    if len(swings) < _MIN_SWINGS:
        return None
    loads, free = gravity[np.concatenate(swings)], _FREE_SHARE * motors.full_duty_nm
    if loads.min() > free or loads.max() < -free:
        return None
    kt = motors.back_emf_nm_s * prior.nominal_v / motors.full_duty_nm
    R = kt * prior.nominal_v * prior.servos / motors.full_duty_nm
    lost, other = (
        _lost_motions(recording, joint, swings, kt, r)
        for r in (R, R * (1.0 + motors.full_duty_error))
    )
    value, by_resistance = np.median(lost), np.median(other) - np.median(lost)
    spread = 1.48 * np.median(np.abs(lost - value)) / np.sqrt(len(lost))
    error = np.linalg.norm([spread, by_resistance, _MIN_BACKLASH_ERROR_RAD])
    return float(np.clip(value, 0.0, _MAX_BACKLASH_RAD)), float(error)


def _swings(recording: DriveRecording, joint: int) -> list[NDArray[np.intp]]:
    """Compute the samples of each leg in which a joint alone moves between two reversals."""
    speed = np.abs(recording.speed)
    legs = [np.flatnonzero(recording.leg == leg) for leg in np.unique(recording.leg)]
    alone = [
        leg for leg in legs
        if speed[leg, joint].max() > _MOVING_RAD_S
        and np.delete(speed[leg], joint, axis=1).max(initial=0.0) < _MOVING_RAD_S
    ]  # fmt: skip
    ways = [np.ptp(recording.goal[leg, joint]) for leg in alone]
    return [leg for leg, way in zip(alone, ways, strict=True) if way > 0.75 * max(ways)]


def _lost_motions(
    recording: DriveRecording, joint: int, swings: Sequence[NDArray[np.intp]], kt: float, R: float
) -> Vector:
    """Compute by how much the motor leads the joint in each swing, against those before and after.

    What drifts evenly cancels.
    """
    time_s, position = recording.time_s, recording.position[:, joint]
    volts = recording.duty[:, joint, 0] * recording.voltage_v[:, joint, 0]
    speed = (volts - R * recording.current_a[:, joint, 0]) / kt
    turned = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time_s)))
    samples = np.concatenate(swings)
    ahead = turned - position
    place = np.abs(position - np.median(position[samples])) / np.ptp(position[samples])
    weights = np.where(place < _MIDDLE, 1.0, _TINY)
    lead = np.array([np.average(ahead[swing], weights=weights[swing]) for swing in swings])
    ends = recording.goal[:, joint]
    ways = np.sign([ends[swing[-1]] - ends[swing[0]] for swing in swings])
    lost: Vector = ways[1:-1] * (lead[1:-1] - 0.5 * (lead[:-2] + lead[2:]))
    return lost
