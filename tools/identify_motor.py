"""Identify servo motors from pendulum logs: electrical constants, inertia, friction.

Run ``python tools/identify_motor.py LOGS`` with the folder of the logs; it takes some minutes on
one core and prints the parameters and the mean absolute error of each kind of trajectory, on the
logs that were fitted and on the others. Results belong in ``sim/servosim/parameters.py``.

The model is that of ``servosim.motor`` (friction that grows with the load, the firmware's ramp of
the target and its duty law), stepped for all logs at once. Goals act when the bench's servo
received them, which is later than they were logged: ``bench_timing.npz`` has each step and release
of the STS logs, and gliding goals are 30 ms late.

The search is differential evolution, because place and duration of sticking change abruptly with
the parameters, and gradient descent stays at its start.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, differential_evolution

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

GRAVITY_M_S2 = 9.81
TICK_RAD = 2.0 * math.pi / 4096
ROD_KG = 0.036
DISC_M2 = 0.0023  # square of the weights' radius of gyration: 10 to 24 % above the point mass
GLIDE_DELAY_S = 0.030
ROW_S = 0.010
SUBSTEPS = 5
NOT_READ = -2047  # position of a row that the bench could not read
FROZEN_ROWS, LEAP_TICKS = (
    20,
    40,
)  # a reading that rests for this many rows and then jumps this far was stale
PROTECTED_ERROR_RAD, PROTECTED_SHARE = 1.7, 0.25  # fraction of the duty from this error on
RESIDUAL_SCALE_DEG = 1.15  # residuals beyond this weigh less
HOLD_WEIGHT = 0.15  # weight of the errors while holding, beside those of all rows
MOST_HOLD_DEG = 5.0  # an error while holding weighs no more than this
SETTLED_ROWS = 30  # rows at the end of a plateau
STEP_ROW, STEP_BACK_ROW = 150, 400  # steps of the trajectory "brutal"
SETS, GENERATIONS, SEED = 32, 45, 1  # size and seed of the search
SPREAD, MOST_CHANGE = 0.15, 1.5  # spread of the first sets and bound, in logarithms

NAMES = (
    "torque_constant_nm_a", "resistance_ohm", "armature_kg_m2", "friction_nm", "viscous_nm_s",
    "stribeck_nm", "stribeck_rad_s", "load_friction", "load_stribeck", "load_square_per_nm",
    "torque_limit_nm",
)  # fmt: skip


@dataclass(frozen=True)
class Firmware:
    """The part of a servo that its firmware decides.

    Attributes:
        duty_per_gain_rad: Duty for one unit of the P gain and one radian.
        startup_duty: Duty that is added in the direction of the error.
        ramp_rad_s: Speed of the target towards a new goal.
        dead_zone_ticks: Errors up to this size count as zero; larger errors are reduced by it.
    """

    duty_per_gain_rad: float
    startup_duty: float
    ramp_rad_s: float
    dead_zone_ticks: float


@dataclass(frozen=True)
class Logs:
    """Logs on one grid of time.

    Attributes:
        name: Name of each log.
        trajectory: Kind of each log.
        p_gain: Gain register of each log.
        mass_kg: Point mass of each log.
        length_m: Distance from the shaft to the mass.
        supply_v: Median voltage of each log.
        position_rad: Measured positions, shape (logs, rows); 0 hangs down.
        goal_rad: Goals as the servo received them, shape (logs, rows * SUBSTEPS).
        torque_on: Whether torque was on, 1 or 0, shape (logs, rows * SUBSTEPS).
    """

    name: NDArray[np.str_]
    trajectory: NDArray[np.str_]
    p_gain: Array
    mass_kg: Array
    length_m: Array
    supply_v: Array
    position_rad: Array
    goal_rad: Array
    torque_on: Array

    def select(self, chosen: Mask) -> Logs:
        """Return the chosen logs."""
        return Logs(*(getattr(self, field.name)[chosen] for field in fields(self)))


@dataclass(frozen=True)
class Bench:
    """Servos to identify.

    Attributes:
        firmware: Model of their firmware.
        read: Reads their logs from the folder.
        start: Start of the search, in the order of NAMES; infinite values are not changed.
        frictions: Fractions of the load-dependent friction at which parameters are judged, because
            a few logs alone would select a set that sticks in the right places by chance.
    """

    firmware: Firmware
    read: Callable[[Path], Logs]
    start: tuple[float, ...]
    frictions: tuple[float, ...] = (1.0,)


def simulate(values: Array, firmware: Firmware, logs: Logs) -> Array:
    """Return positions [rad] of shape (sets, logs, rows) for parameter sets (sets, NAMES)."""
    kt, ohm, armature, base, viscous, stribeck, slow, load, load_slow, square, most_nm = values.T[
        :, :, None
    ]
    dt_s, rows = ROW_S / SUBSTEPS, logs.position_rad.shape[1]
    length, mass = logs.length_m, logs.mass_kg
    inertia = armature + mass * (length**2 + DISC_M2) + ROD_KG * length**2 / 3.0
    weight_nm = GRAVITY_M_S2 * length * (mass + ROD_KG / 2.0)
    full_nm, back_emf = kt / ohm * logs.supply_v, kt * kt / ohm
    position = np.broadcast_to(logs.position_rad[:, 0], (len(values), len(mass))).copy()
    velocity, reference = np.zeros_like(position), position.copy()
    out = np.empty((rows, *position.shape))
    for k in range(rows * SUBSTEPS):
        if k % SUBSTEPS == 0:
            out[k // SUBSTEPS] = position
        on = logs.torque_on[:, k]
        reference = step_reference(reference, logs.goal_rad[:, k], firmware.ramp_rad_s * dt_s)
        drive_nm = full_nm * duty_of(reference - position, firmware, logs.p_gain) * on
        damping = back_emf * on
        free_nm = drive_nm - damping * velocity
        limited = np.abs(free_nm) > most_nm
        motor_nm = np.clip(free_nm, -most_nm, most_nm)
        damping = np.where(limited, 0.0, damping) + viscous
        load_nm = -weight_nm * np.sin(position)
        gear_nm = np.abs(motor_nm - load_nm)
        slowness = np.exp(-np.abs(velocity) / slow)
        dry_nm = base + gear_nm * (load + square * gear_nm)
        dry_nm += slowness * (stribeck + load_slow * gear_nm)
        per_nm = dt_s / (inertia + dt_s * damping)
        velocity += per_nm * (motor_nm + load_nm - viscous * velocity)
        stopped: Array = np.maximum(np.abs(velocity) - per_nm * dry_nm, 0.0)
        velocity = stopped * np.sign(velocity)
        position += dt_s * velocity
    return np.moveaxis(out, 0, -1)


def step_reference(reference: Array, goal: Array, most_rad: float) -> Array:
    """Return the firmware's target after a step towards the goal."""
    return reference + np.clip(goal - reference, -most_rad, most_rad)


def duty_of(error_rad: Array, firmware: Firmware, p_gain: Array) -> Array:
    """Return the duty -1..1 that the firmware's position loop gives."""
    ticks = np.rint(error_rad / TICK_RAD)
    ticks = np.sign(ticks) * np.maximum(np.abs(ticks) - firmware.dead_zone_ticks, 0.0)
    error = ticks * TICK_RAD
    duty = firmware.duty_per_gain_rad * p_gain * error + firmware.startup_duty * np.sign(error)
    return np.clip(duty, -1.0, 1.0)


def read_kscale(folder: Path, name: str) -> Logs:
    """Return the STS logs of a file, with goals at the moments when the servo received them.

    Logs whose readings dropped out are left out: see `has_stale_readings`.
    """
    data, late = np.load(folder / name), np.load(folder / "bench_timing.npz")
    index = {str(log): k for k, log in enumerate(late["name"])}
    grid, fine = np.arange(600) * ROW_S, np.arange(600 * SUBSTEPS) * ROW_S / SUBSTEPS
    columns: list[tuple[Array, Array, Array]] = []
    ticks = np.split(data["position_tick"], data["start"][1:-1])
    chosen = np.flatnonzero([not has_stale_readings(tick[tick != NOT_READ]) for tick in ticks])
    for i in chosen:
        rows = slice(data["start"][i], data["start"][i + 1])
        at_s, goal = data["time_100us"][rows] * 1e-4, data["goal_100urad"][rows] * 1e-4
        tick, k = ticks[i], index.get(str(data["name"][i]))
        position: Array = _interpolated(
            grid, at_s[tick != NOT_READ], tick[tick != NOT_READ] * TICK_RAD
        )
        received, on = _interpolated(fine - GLIDE_DELAY_S, at_s, goal), np.ones_like(fine)
        if k is not None and data["trajectory"][i] == "brutal":
            received = _delayed_steps(
                fine, at_s, goal, (late["step_up_s"][k], late["step_down_s"][k])
            )
        elif k is not None:
            on = np.where(fine < late["release_s"][k], 1.0, 0.0)
        columns.append((position, received, on))
    volts = np.array(
        [np.median(part) / 10.0 for part in np.split(data["supply_dv"], data["start"][1:-1])]
    )
    return _logs_of(data, chosen, volts[chosen], columns)


def has_stale_readings(tick: NDArray[Any]) -> bool:
    """Return whether a position stands still for 0.2 s and then jumps within one row of 10 ms.

    A shaft that breaks loose needs several rows for that many ticks; a reading that the bus did
    not renew shows the whole motion at once.
    """
    moved = np.flatnonzero(np.diff(tick.astype(int)))
    stood = np.diff(moved, prepend=-1)
    leaps = np.abs(np.diff(tick.astype(int)))[moved]
    return bool(np.any((stood >= FROZEN_ROWS) & (leaps > LEAP_TICKS)))


def _delayed_steps(fine: Array, at_s: Array, goal: Array, delays_s: tuple[float, float]) -> Array:
    """Return a goal that steps as often as the logged one, each step later by its delay."""
    received = np.full(len(fine), goal[0])
    for k, delay_s in zip(np.flatnonzero(np.diff(goal)), delays_s, strict=False):
        received[fine >= at_s[k + 1] + delay_s] = goal[k + 1]
    return received


def _interpolated(at_s: NDArray[Any], times_s: NDArray[Any], values: NDArray[Any]) -> Array:
    return np.asarray(np.interp(at_s, times_s, values), dtype=np.float64)


XL330_DELAY_S = 0.0  # delay of goals after the log
XL330_OFFSET_RAD = 0.0155  # position in which the pendulum of the bench hangs


def read_bam(folder: Path) -> Logs:
    """Return the XL330 logs of Rhoban's bench."""
    data = np.load(folder / "bam_xl330_sts3250_pendulum.npz")
    chosen = np.flatnonzero(data["motor"] == "xl330")
    table = data["rows_t_goal_pos_torque_volts"].astype(float)
    parts = [table[data["start"][i] : data["start"][i + 1]].T for i in chosen]
    rows = int(min(at_s[-1] for at_s, *_ in parts) / ROW_S)
    grid, fine = np.arange(rows) * ROW_S, np.arange(rows * SUBSTEPS) * ROW_S / SUBSTEPS
    columns = [
        (
            _interpolated(grid, at_s, position + XL330_OFFSET_RAD),
            _interpolated(fine - XL330_DELAY_S, at_s, goal + XL330_OFFSET_RAD),
            np.where(_interpolated(fine - XL330_DELAY_S, at_s, on) > 0.5, 1.0, 0.0),
        )
        for at_s, goal, position, on, _ in parts
    ]
    return _logs_of(data, chosen, np.array([np.median(part[4]) for part in parts]), columns)


def _logs_of(
    data: Mapping[str, NDArray[Any]],
    chosen: NDArray[np.intp],
    volts: Array,
    columns: list[tuple[Array, Array, Array]],
) -> Logs:
    position, goal, on = (np.stack(column) for column in zip(*columns, strict=True))
    return Logs(
        data["name"][chosen], data["trajectory"][chosen], data["p_gain"][chosen].astype(float),
        data["mass_kg"][chosen], data["length_m"][chosen], volts, position, goal, on,
    )  # fmt: skip


def split(logs: Logs) -> Mask:
    """Return the logs to fit: a chessboard of masses, gains and lengths; the others validate."""
    places = [
        np.searchsorted(np.unique(of), of) for of in (logs.mass_kg, logs.p_gain, logs.length_m)
    ]
    return np.sum(places, axis=0) % 2 == 0


def fit(bench: Bench, logs: Logs) -> Array:
    """Return the parameters that fit best, searched as logarithms around the start."""
    start = np.array(bench.start)
    sought = np.isfinite(start)
    middle = np.log(start[sought])
    first = middle + SPREAD * np.random.default_rng(SEED).standard_normal((SETS, len(middle)))
    first[0] = middle
    shares = np.ones((len(bench.frictions), len(NAMES)))
    for name in ("load_friction", "load_stribeck"):
        shares[:, NAMES.index(name)] = bench.frictions

    def losses(x: Array) -> Array:
        values = np.tile(start, (x.shape[1], 1))
        values[:, sought] = np.exp(x.T)
        return np.mean([losses_of(values * near, bench.firmware, logs) for near in shares], axis=0)

    found = differential_evolution(
        losses,  # pyright: ignore[reportArgumentType] - the stubs lack vectorized
        Bounds(middle - MOST_CHANGE, middle + MOST_CHANGE), init=first, maxiter=GENERATIONS,
        tol=0.0, rng=SEED, polish=False, updating="deferred", vectorized=True,
    )  # fmt: skip
    values = start.copy()
    values[sought] = np.exp(found.x)
    return values


def losses_of(values: Array, firmware: Firmware, logs: Logs) -> Array:
    """Return the loss that the search minimises, for parameter sets (sets, NAMES).

    The error of a row counts by its square if small and by its magnitude if large; the error that
    remains while the servo holds counts in addition.
    """
    error_deg = np.degrees(np.abs(simulate(values, firmware, logs) - logs.position_rad))
    rows = np.sqrt(1.0 + (error_deg / RESIDUAL_SCALE_DEG) ** 2) - 1.0
    return rows.mean(axis=(1, 2)) + HOLD_WEIGHT * _hold_errors_deg(error_deg, logs).mean(axis=-1)


def _hold_errors_deg(error_deg: Array, logs: Logs) -> Array:
    """Return the mean errors at the ends of plateaus, shape (sets, logs that have one)."""
    step = slice(STEP_BACK_ROW - SETTLED_ROWS, STEP_BACK_ROW - 1)
    above = error_deg[:, logs.trajectory == "up_and_down", -SETTLED_ROWS:].mean(axis=-1)
    below = error_deg[:, logs.trajectory == "brutal", step].mean(axis=-1)
    return np.minimum(np.concatenate([above, below], axis=1), MOST_HOLD_DEG)


def mean_errors_deg(values: Array, firmware: Firmware, logs: Logs) -> Array:
    """Return the mean absolute error of each log [degrees]."""
    error_rad = simulate(values[None], firmware, logs)[0] - logs.position_rad
    return np.degrees(np.abs(error_rad).mean(axis=-1))


def print_errors(title: str, values: Array, firmware: Firmware, logs: Logs) -> None:
    """Print the median of the mean absolute errors of each kind of trajectory."""
    errors = mean_errors_deg(values, firmware, logs)
    kinds = np.unique(logs.trajectory)
    found = [f"{kind} {np.median(errors[logs.trajectory == kind]):.2f}" for kind in kinds]
    print(f"  {title:<52}{', '.join(found)}; all {np.median(errors):.2f} degrees", flush=True)


WITHOUT: dict[str, dict[str, float]] = {
    "load-dependent friction": {
        "load_friction": 0.0, "load_stribeck": 0.0, "load_square_per_nm": 0.0,
    },
    "its part that grows with the square of the load": {"load_square_per_nm": 0.0},
    "Stribeck friction": {"stribeck_nm": 0.0, "load_stribeck": 0.0},
    "all dry friction": {
        "friction_nm": 0.0, "stribeck_nm": 0.0, "load_friction": 0.0, "load_stribeck": 0.0,
        "load_square_per_nm": 0.0,
    },
    "torque limit": {"torque_limit_nm": math.inf},
    "armature": {"armature_kg_m2": 0.0},
}  # fmt: skip


def print_sensitivity(values: Array, firmware: Firmware, logs: Logs) -> None:
    """Print the errors with one part of the model removed and nothing fitted again."""
    for part, changes in WITHOUT.items():
        changed = values.copy()
        for name, value in changes.items():
            changed[NAMES.index(name)] = value
        print_errors(f"without {part}", changed, firmware, logs)
    for part, without in (
        ("target ramp", replace(firmware, ramp_rad_s=math.inf)),
        ("start-up force", replace(firmware, startup_duty=0.0)),
        (
            "half of the P gain",
            replace(firmware, duty_per_gain_rad=0.5 * firmware.duty_per_gain_rad),
        ),
    ):
        print_errors(f"without {part}", values, without, logs)


BENCHES = {
    "STS3215-C018": Bench(
        Firmware(0.163, 0.016, 66 * 50 * TICK_RAD, 1.0),
        lambda folder: read_kscale(folder, "kscale_sts3215_12v_pendulum.npz"),
        (2.218, 3.564, 0.0213, 0.1266, 0.0246, 0.0474, 0.226, 0.096, 0.0687, 0.0199, 3.31),
    ),
    "STS3250": Bench(
        Firmware(0.163, 0.005, 110 * 50 * TICK_RAD, 1.0),
        lambda folder: read_kscale(folder, "kscale_sts3250_pendulum.npz"),
        (1.43, 1.615, 0.00849, 0.0427, 0.0499, 0.0286, 0.0735, 0.097, 0.0255, 0.022, 3.93),
    ),
    "XL330-M288": Bench(
        Firmware(1.0 / (256 * 885 * TICK_RAD), 0.0, math.inf, 0.0),
        read_bam,
        (0.39, 3.04, 0.00158, 0.0022, 0.000575, 0.00389, 0.238, 0.145, 0.0785, 0.18, math.inf),
        (0.97, 1.0, 1.03),
    ),
}
"""Start values: results of earlier searches, which began at K-Scale's and Rhoban's fits."""


def identify(name: str, logs: Logs) -> None:
    """Fit one servo and print the results."""
    bench = BENCHES[name]
    fitted = split(logs) if len(logs.name) > 100 else np.ones(len(logs.name), bool)
    found = fit(bench, logs.select(fitted))
    print(f"{name}: {fitted.sum()} logs fitted, {(~fitted).sum()} for validation")
    for parameter, value in zip(NAMES, found, strict=True):
        print(f"  {parameter:<22}{value:.5g}")
    print_errors("fitted", found, bench.firmware, logs.select(fitted))
    kept = logs
    if not fitted.all():  # few logs are all fitted
        kept = logs.select(~fitted)
        print_errors("validation", found, bench.firmware, kept)
    print_sensitivity(found, bench.firmware, kept)


def main() -> None:
    """Identify the requested servos."""
    parser = argparse.ArgumentParser(description="Identify servo motors from pendulum logs.")
    parser.add_argument("logs", type=Path, help="folder of the logs")
    parser.add_argument("--servo", choices=tuple(BENCHES), help="only this servo")
    options = parser.parse_args()
    for name in (options.servo,) if options.servo else BENCHES:
        try:
            logs = BENCHES[name].read(options.logs)
        except OSError as error:
            parser.error(f"cannot read the logs of {name}: {error}")
        identify(name, logs)


if __name__ == "__main__":
    main()
