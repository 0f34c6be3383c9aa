"""Fit motors, position loops and backlash of single joints, from steady motion and swings.

If a servo measures its current, ``u V = R i + kt w``, with the duty u, the supply V and the speed
w, determines the motor's resistance R and torque constant kt, which is also the back-EMF. The
position loop is a spring to the goal: ``u = k (e - d w) + u0 sign(e)`` with the error e and the
start-up force u0; d represents delays and the D gain between two goals. The motor's speed, from
its back-EMF, minus the joint's speed shows motion within the backlash.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ikservo.apps.lab.drive_recording import Cube, DriveRecording, SteadyWindows, smooth_samples
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.model.servo_torque import ServoTorque

# Errors of a window's volts, from counts of the duty and from steps of the supply's reading.
# Similar windows share the latter, so together they count as no more than this many windows.
_VOLTS, _SUPPLY_VOLTS, _MIN_WINDOWS = 0.01, 0.03, 10
# While gears cross their backlash, motor and joint have different speeds. A window is left out if
# they differ by more than this many of those errors and this many times the median difference. If
# more than half of the windows differ, the joint swings by itself.
_SWINGING, _OUTLIER = 3.0, 4.0
_TRIMMING_ROUNDS = 4  # iterations that find the differing windows
_NOMINAL_SHARE = 0.1  # relative deviation of a servo's winding and magnets from its model's
# Relative deviation of the duty per rad from the firmware's, with a known and with an unread gain.
_KNOWN_GAIN_SHARE, _GAIN_SHARE = 0.02, 0.3
_DELAY_S, _DELAY_DEVIATION_S = 0.0, 0.03
_LOOP_NOISE = 0.004  # least noise of a window's mean duty
_NOISY_DUTY = 0.015  # noise of a window's mean above which leads are more precise than duties
_NOISE_ROUNDS = 3  # iterations that find the noise
_MOVING_RAD_S, _MIN_SWINGS = 0.05, 4
# A slower motor counts as at rest: one step of an XL330's or STS's current is as large as this.
_STUCK_RAD_S = 0.01
# The gears of a joint are unloaded if gravity is below this fraction of its torque at full duty.
_FREE_SHARE = 0.01
# Places that are compared, from the middle of a swing, and their width, as fractions of the swing.
_PLACES, _PLACE_WIDTH = np.linspace(-0.4, 0.4, 17), 0.03
# If this many places agree on the backlash within this tolerance, they show all of it.
_ALIKE_PLACES, _ALIKE_SHARE, _ALIKE_RAD = 3, 0.1, 0.002
_MAX_BACKLASH_RAD = 0.2
# Largest difference of the motor's and the joint's speed unless gears cross their backlash, and the
# weight of changes of the motor's speed: its rotor has inertia, and the joint is read in ticks.
_CROSSING_RAD_S, _INERTIA = 0.2, 4.0
_MIN_BACKLASH_ERROR_RAD = 0.001  # about a tick


@dataclass(frozen=True, slots=True)
class JointPrior:
    """Prior of a joint's drive, from the models of its servos.

    Attributes:
        servo: The model of one of its servos.
        servos: The number of servos that drive it.
        nominal_v: The supply voltage for which these figures hold.
        per_horn_rad: Motion of the joint per rad of the horns.
        full_duty_share: Relative standard deviation of the torque at full duty.
        gain: The present P gain, as a fraction of the usual P gain of the servo's model; None if
            it was not read.
    """

    servo: ServoTorque
    servos: int
    nominal_v: float
    per_horn_rad: float = 1.0
    full_duty_share: float = 0.05
    gain: float | None = 1.0

    @property
    def full_duty_nm(self) -> float:
        """Torque of all servos at full duty, at the joint."""
        return self.force * self.servo.full_duty_nm

    @property
    def kt(self) -> float:
        """The torque constant of one of its motors, N m/A at the horn."""
        return self.servo.damping_nm_s * self.nominal_v / self.servo.full_duty_nm

    @property
    def ohm(self) -> float:
        """The resistance of one of its motors."""
        return self.kt * self.nominal_v / self.servo.full_duty_nm

    @property
    def force(self) -> float:
        """Torque at the joint per N m at the horn of each servo."""
        return self.servos / self.per_horn_rad


@dataclass(frozen=True, slots=True, eq=False)
class Winding:
    """The motor of one servo, referred to the horn, identified from duty, current and speed.

    Attributes:
        ohm: The resistance of the winding.
        kt: The torque constant, N m/A.
        covariance: The covariance (2, 2) of the errors of ``ohm`` and ``kt``.
    """

    ohm: float
    kt: float
    covariance: Matrix

    @property
    def torque_error(self) -> float:
        """Relative standard error of the torque per volt."""
        gradient = np.array([-1.0 / self.ohm, 1.0 / self.kt])
        return float(np.sqrt(gradient @ self.covariance @ gradient))


@dataclass(frozen=True, slots=True, eq=False)
class MotorConstants:
    """The motors of all servos of a joint together, at the joint.

    Attributes:
        windings: The windings of each servo.
        nominal_v: The supply voltage for which the full duty holds.
        per_horn_rad: Motion of the joint per rad of the horns.
    """

    windings: Sequence[Winding]
    nominal_v: float
    per_horn_rad: float = 1.0

    @property
    def full_duty_nm(self) -> float:
        """Torque at full duty and nominal supply."""
        torque_nm = sum(each.kt / each.ohm for each in self.windings) * self.nominal_v
        return torque_nm / self.per_horn_rad

    @property
    def full_duty_error(self) -> float:
        """Relative standard error of ``full_duty_nm``."""
        errors = np.array([each.torque_error for each in self.windings])
        return float(np.linalg.norm(errors) / len(errors))

    @property
    def back_emf_nm_s(self) -> float:
        """Braking torque kb on the joint per rad/s."""
        return sum(each.kt**2 / each.ohm for each in self.windings) / self.per_horn_rad**2


@dataclass(frozen=True, slots=True)
class LoopFit:
    """The position loop of a joint's servos.

    Attributes:
        duty_per_rad: Duty per rad (m) between goal and joint.
        duty_per_rad_error: The standard error of ``duty_per_rad``.
        share_before: The relative prior standard deviation of ``duty_per_rad``.
        startup_duty: Duty that is added in the direction of the error.
        delay_s: The delay d with which the duty responds to the measured position.
        noise: The RMS deviation of the duty from this fit; the D gain responds to the steps of
            goals and position.
    """

    duty_per_rad: float
    duty_per_rad_error: float
    share_before: float
    startup_duty: float
    delay_s: float = 0.0
    noise: float = 0.0


def fit_motors(windows: SteadyWindows, prior: JointPrior) -> MotorConstants | None:
    """Fit the motors of a joint from signed currents; None if a servo does not measure them."""
    found = [_winding(windows, k, prior) for k in range(prior.servos)]
    fits = [each for each in found if each is not None]
    if len(fits) < len(found):
        return None
    return MotorConstants(fits, prior.nominal_v, prior.per_horn_rad)


def _winding(windows: SteadyWindows, servo: int, prior: JointPrior) -> Winding | None:
    """Return the motor of one servo; None if it does not measure its current.

    While gears cross their backlash, motor and joint have different speeds; such windows are left
    out. If a joint swings in its backlash, too few windows remain, and the nominal motor is
    returned.
    """
    current = windows.current_a[:, servo]
    used = np.isfinite(current)
    if np.count_nonzero(used) < _MIN_WINDOWS:
        return None
    duty = windows.duty[used, servo]
    volts = duty * windows.voltage_v[used, servo]
    noise = np.hypot(_VOLTS, _SUPPLY_VOLTS * duty)
    causes = np.column_stack([current, windows.speed / prior.per_horn_rad])[used] / noise[:, None]
    nominal = np.array([prior.ohm, prior.kt])
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
    covariance = np.asarray(np.linalg.inv(A.T @ A), dtype=np.float64)
    return Winding(R, kt, covariance) if R > 0.0 and kt > 0.0 else None


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
    """Return windows with their mean duties over time, which balance friction and load.

    Servos are read between two goals, while the D gain brakes the joint. At each new goal the D
    gain drives the joint as strongly, but too briefly to be read; the error also falls between
    goals. If the D gain makes the duties noisy, duties computed from the leads are used.
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
    """Add signs to the currents of servos that measure only the magnitude.

    The sign is chosen so that the motor's speed, from its back-EMF, is close to the joint's speed
    and to its own speed before and after: motor and joint differ while gears cross their backlash,
    but the rotor has inertia.
    """
    current, volts = recording.current_a.copy(), recording.duty * recording.voltage_v
    speeds = smooth_samples(np.gradient(recording.position, recording.time_s, axis=0))
    for j, prior in enumerate(priors):
        for k in range(prior.servos):
            sizes = current[:, j, k]
            if (sizes >= 0.0).all():
                either = np.column_stack([sizes, -sizes])
                motor = (volts[:, j, k, None] - prior.ohm * either) / prior.kt
                chosen = _likeliest(motor, speeds[:, j] / prior.per_horn_rad)
                current[:, j, k] = either[np.arange(len(sizes)), chosen]
    return replace(recording, current_a=current)


def _likeliest(motor: Matrix, joint: Vector) -> NDArray[np.intp]:
    """Choose between two speeds (m, 2) of the motor in each sample, given the joint speeds (m,).

    The sequence with the least sum of differences from the joint's speed and between samples is
    returned (algorithm of Viterbi, 1967).
    """
    costs = np.minimum(np.abs(motor - joint[:, None]), _CROSSING_RAD_S)
    changes = _INERTIA * np.abs(motor[1:, None, :] - motor[:-1, :, None])
    (first, second), before = costs[0].tolist(), list[tuple[int, int]]()
    for ((a, b), (c, d)), cost in zip(changes.tolist(), costs[1:].tolist(), strict=True):
        before.append((int(second + c < first + a), int(second + d < first + b)))
        first, second = min(first + a, second + c) + cost[0], min(first + b, second + d) + cost[1]
    last = [int(second < first)]
    for choices in reversed(before):
        last.append(choices[last[-1]])
    return np.array(last[::-1])


def fit_backlash(
    recording: DriveRecording, joint: int, gravity: Vector, motors: MotorConstants
) -> tuple[float, float] | None:
    """Fit the backlash of a joint and its standard error, rad; None if it cannot be measured.

    If a joint swings alone, nearly without load, its gears cross their backlash: the motor is ahead
    of the joint in one direction and behind it in the other. Errors of kt cancel if the joint
    passes the same place both ways. A joint that falls through its balance is pushed one way and
    then the other in each swing, so the full backlash shows only near the balance, at the places
    with the largest difference. The combined error of R and kt is smaller than the error of either,
    because they were fitted to motion with currents like the currents of a swing. Currents need a
    sign; the gears stay on one side if ``gravity``, the torque in each sample (m,), keeps its sign.
    """
    swings = _swings(recording, joint)
    if len(swings) < _MIN_SWINGS:
        return None
    loads, free = gravity[np.concatenate(swings)], _FREE_SHARE * motors.full_duty_nm
    if loads.min() > free or loads.max() < -free:
        return None
    motor = motors.windings[0]
    by_volts, by_amps, by_joint = np.moveaxis(_lost_motions(recording, joint, swings, motor), 2, 0)
    turned = motors.per_horn_rad / motor.kt * (by_volts - motor.ohm * by_amps)
    if turned.shape[1] < _ALIKE_PLACES:
        return None
    by_place = np.median(turned - by_joint, axis=0)
    most = by_place.max()
    alike = by_place >= most - max(_ALIKE_SHARE * most, _ALIKE_RAD)
    if np.count_nonzero(alike) < _ALIKE_PLACES:
        return None
    by_amps, turned = by_amps[:, alike].mean(axis=1), turned[:, alike].mean(axis=1)
    lost = turned - by_joint[:, alike].mean(axis=1)
    value = float(np.median(lost))
    spread = 1.48 * np.median(np.abs(lost - value)) / np.sqrt(len(lost))
    gradient = np.array([  # derivative of the backlash by R and kt
        -motors.per_horn_rad / motor.kt * np.median(by_amps),
        -np.median(turned) / motor.kt,
    ])  # fmt: skip
    variance = spread**2 + gradient @ motor.covariance @ gradient + _MIN_BACKLASH_ERROR_RAD**2
    return float(np.clip(value, 0.0, _MAX_BACKLASH_RAD)), float(np.sqrt(variance))


def _swings(recording: DriveRecording, joint: int) -> list[NDArray[np.intp]]:
    """Return the samples of each leg in which one joint moves alone between two reversals."""
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
    recording: DriveRecording, joint: int, swings: Sequence[NDArray[np.intp]], motor: Winding
) -> Cube:
    """Compute how opposite swings differ at the same places (k, places, 3).

    The last axis holds the integrals of voltage and current, and the joint position.

    Each swing is compared with the swings before and after, so that steady drift cancels. A motor
    whose speed cannot be distinguished from rest counts as stuck, because the
    quantisation of its sensors would accumulate in the integrals.
    """
    time_s, position = recording.time_s, recording.position[:, joint]
    current = recording.current_a[:, joint, 0]
    volts = recording.duty[:, joint, 0] * recording.voltage_v[:, joint, 0]
    turns = np.abs(volts - motor.ohm * current) > _STUCK_RAD_S * motor.kt
    volts, current = turns * volts, turns * current
    series = np.column_stack([_integral(volts, time_s), _integral(current, time_s), position])
    samples = position[np.concatenate(swings)]
    places = (position - np.median(samples)) / np.ptp(samples)
    near = np.abs(places[:, None] - _PLACES) < _PLACE_WIDTH
    reached = np.all([near[swing].any(axis=0) for swing in swings], axis=0)
    weights = near[:, reached].astype(np.float64)
    lead = np.array([
        weights[swing].T @ series[swing] / weights[swing].sum(axis=0)[:, None] for swing in swings
    ])  # fmt: skip
    ends = recording.goal[:, joint]
    ways = np.sign([ends[swing[-1]] - ends[swing[0]] for swing in swings])
    lost: Cube = ways[1:-1, None, None] * (lead[1:-1] - 0.5 * (lead[:-2] + lead[2:]))
    return lost


def _integral(rate: Vector, time_s: Vector) -> Vector:
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(time_s)
    return np.concatenate([[0.0], np.cumsum(steps)])
