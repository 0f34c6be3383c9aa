"""Compare simulated with measured servos by replaying pendulum logs through the bus.

Run ``python tools/bench/motor_truth.py LOGS [--every N] [--pictures FOLDER]`` with the folder of
the logs that ``tools/identify_motor.py`` reads. Each log is one conversation: gains and goals are
written and positions read as on the bench, goals at the moments when the bench's servo received
them. Figures belong in docs/lab/simulated-motors.md.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1]))

from identify_motor import BENCHES, DISC_M2, GRAVITY_M_S2, ROD_KG, ROW_S, SUBSTEPS, Logs

from servosim.frames import encode1, encode2
from servosim.joint import SimulatedJoint
from servosim.line import Line
from servosim.motor import Motor
from servosim.parameters import PARAMETERS, MotorParameters
from servosim.port import SimulatedPort
from servosim.register import SimulatedFamily
from servosim.servo import HornMounting
from servosim.servo_models import make_servo, table_for
from servosim.world import PowerSupply, World

Array = NDArray[np.float64]

BAUD = 1_000_000
RAD_PER_TICK = 2.0 * math.pi / 4096
SETTLED_ROWS = 30  # rows at the end of a plateau
# The bench's readings are unevenly late: from row to row the speed of a uniform motion seems to
# alternate between 3.7 and 5.6 rad/s, in the same way every 40 ms.
UNEVEN_ROWS = 4
STEP_ROW, STEP_BACK_ROW = 150, 400  # steps of the trajectory "brutal"


@dataclass(frozen=True)
class Pendulum:
    """A mass on a rod that the servo turns; at zero, it hangs down."""

    mass_kg: float
    length_m: float
    names: tuple[str, ...] = ("pendulum",)
    limits: tuple[tuple[float, float], ...] = ((-math.inf, math.inf),)

    def load_nm(self, positions: Sequence[float], velocities: Sequence[float]) -> list[float]:
        """Return the torque of gravity."""
        weight_nm = GRAVITY_M_S2 * self.length_m * (self.mass_kg + ROD_KG / 2.0)
        return [-weight_nm * math.sin(positions[0])]

    def mass_matrix(self, positions: Sequence[float]) -> list[list[float]]:
        """Return the inertia of mass and rod."""
        square = self.length_m**2
        return [[self.mass_kg * (square + DISC_M2) + ROD_KG * square / 3.0]]


class BenchServo:
    """One servo with a pendulum behind a simulated line, as a program on the bench sees it."""

    def __init__(self, model: str, logs: Logs, log: int, parameters: MotorParameters) -> None:
        table = table_for(model)
        self._feetech = table.family is SimulatedFamily.FEETECH_STS
        motor = Motor(parameters, float(logs.position_rad[log, 0]))
        delivered = {"id": 1}
        if not self._feetech:  # the XL330's bench had 7.3 V and no overload shutdown in six seconds
            delivered |= {"return_delay_time": 0, "baud_rate": 3, "max_voltage_limit": 90}
            delivered["shutdown"] = 0
        servo = make_servo(model, motor, HornMounting(1, 2048, 4096), delivered)
        body = Pendulum(float(logs.mass_kg[log]), float(logs.length_m[log]))
        supply = PowerSupply(float(logs.supply_v[log]), resistance_ohm=0.0)
        rails = {motor.parameters.nominal_v: supply}
        self.port = SimulatedPort(
            Line(World([SimulatedJoint("pendulum", (servo,))], body, rails), BAUD)
        )
        self.port.timeout = 0.005
        names = table.by_name
        self._row = {
            name: names[name] for name in ("goal_position", "torque_enable", "present_position")
        }
        gains = ("p_gain", "i_gain", "d_gain") if self._feetech else (
            "position_p_gain", "position_i_gain", "position_d_gain")  # fmt: skip
        for name, value in zip(gains, (int(logs.p_gain[log]), 0, 0), strict=True):
            self._row[name] = names[name]
            self.write(name, value)

    def write(self, name: str, value: int) -> None:
        """Write a register with one frame and wait for its status."""
        row = self._row[name]
        data = row.encode(value)
        if self._feetech:
            self.port.write(encode1(1, 3, bytes((row.address,)) + data))
            self.port.read(6)
        else:
            self.port.write(encode2(1, 3, row.address.to_bytes(2, "little") + data))
            self.port.read(11)

    def position_rad(self) -> float:
        """Read the present position with one frame."""
        row = self._row["present_position"]
        if self._feetech:
            self.port.write(encode1(1, 2, bytes((row.address, row.size))))
            raw = self.port.read(6 + row.size)[5:-1]
        else:
            head = row.address.to_bytes(2, "little") + row.size.to_bytes(2, "little")
            self.port.write(encode2(1, 2, head))
            raw = self.port.read(11 + row.size)[9:-2]
        return (row.decode(raw) - 2048) * RAD_PER_TICK


def replay(model: str, logs: Logs, log: int, parameters: MotorParameters | None = None) -> Array:
    """Return the positions [rad] that the simulated servo reports at the log's moments.

    Args:
        model: Model of the servo.
        logs: The logs.
        log: Index of the log to replay.
        parameters: Parameters of the servo; None uses those of the table.
    """
    servo = BenchServo(model, logs, log, parameters or PARAMETERS[model])
    clock, start_s = servo.port.clock, 0.05
    goals = np.rint(logs.goal_rad[log] / RAD_PER_TICK).astype(int) + 2048
    on = logs.torque_on[log] > 0.5
    servo.write("goal_position", int(goals[0]))
    servo.write("torque_enable", 1)
    rows = logs.position_rad.shape[1]
    found, was, held = np.empty(rows), int(goals[0]), True
    for k in range(rows * SUBSTEPS):
        at_s = start_s + k * ROW_S / SUBSTEPS
        clock.sleep_until(max(at_s, clock.now_s()))
        if k % SUBSTEPS == 0:
            found[k // SUBSTEPS] = servo.position_rad()
        if held and not on[k]:
            servo.write("torque_enable", 0)
            held = False
        # Written in each substep: once per record would be half a record later than on the bench.
        if held and goals[k] != was:
            was = int(goals[k])
            servo.write("goal_position", was)
    return found


@dataclass(frozen=True)
class Figures:
    """Figures of a servo from a step or a sine; NaN if the trajectory does not show them."""

    hold_deg: float = math.nan
    rise_s: float = math.nan
    peak_rad_s: float = math.nan
    lag_s: float = math.nan


def figures_of(kind: str, goal_rad: Array, position_rad: Array) -> Figures:
    """Compute the figures that a trajectory of this kind shows.

    Args:
        kind: Kind of the trajectory.
        goal_rad: Goals at the rows.
        position_rad: Positions at the rows.
    """
    moved_rad = np.abs(position_rad[UNEVEN_ROWS:] - position_rad[:-UNEVEN_ROWS]).max()
    speed = moved_rad / (UNEVEN_ROWS * ROW_S)
    if kind == "brutal":
        settled = slice(STEP_BACK_ROW - SETTLED_ROWS, STEP_BACK_ROW - 1)
        hold = np.mean(goal_rad[settled] - position_rad[settled])
        return Figures(math.degrees(hold), _rise_s(position_rad), float(speed))
    if kind == "up_and_down":
        hold = np.mean((goal_rad - position_rad)[-SETTLED_ROWS:])
        return Figures(hold_deg=math.degrees(hold))
    if kind == "sin_sin":
        return Figures(lag_s=_lag_s(goal_rad, position_rad))
    return Figures()


def _rise_s(position_rad: Array) -> float:
    """Return the time from 10 to 90 % of the step."""
    up = position_rad[STEP_ROW : STEP_BACK_ROW - 1]
    first, last = position_rad[STEP_ROW - 1], up[-SETTLED_ROWS:].mean()
    share = (up - first) / (last - first)
    times = [_crossing(share, level) for level in (0.1, 0.9)]
    return (times[1] - times[0]) * ROW_S


def _crossing(share: Array, level: float) -> float:
    k = int(np.argmax(share >= level))
    return k - (share[k] - level) / (share[k] - share[k - 1]) if k else 0.0


def _lag_s(goal_rad: Array, position_rad: Array) -> float:
    """Return the time shift that fits the goal best to the position."""
    grid = np.arange(len(goal_rad)) * ROW_S
    shifts = np.arange(0.0, 0.4, 0.001)
    inner = slice(50, None)
    errors = [np.std((np.interp(grid - s, grid, goal_rad) - position_rad)[inner]) for s in shifts]
    return float(shifts[int(np.argmin(errors))])


def compare(model: str, logs: Logs, every: int) -> list[tuple[str, int, float, Figures, Figures]]:
    """Replay every n-th log; return kind, gain, mean error [degrees] and figures of both."""
    rows: list[tuple[str, int, float, Figures, Figures]] = []
    for log in range(0, len(logs.name), every):
        found, measured = replay(model, logs, log), logs.position_rad[log]
        kind = str(logs.trajectory[log])
        goal = logs.goal_rad[log][::SUBSTEPS]
        error = float(np.degrees(np.abs(found - measured).mean()))
        both = figures_of(kind, goal, found), figures_of(kind, goal, measured)
        rows.append((kind, int(logs.p_gain[log]), error, *both))
    return rows


def print_table(model: str, rows: list[tuple[str, int, float, Figures, Figures]]) -> None:
    """Print medians for each trajectory and gain: simulated / measured (difference)."""
    print(f"\n| {model} | P | logs | error ° | hold ° sim / real | rise s | peak rad/s | lag s |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|")
    for kind in sorted({row[0] for row in rows}):
        of_kind = [row for row in rows if row[0] == kind]
        for gain in [*sorted({row[1] for row in of_kind}), None]:
            chosen = [row for row in of_kind if gain in (None, row[1])]
            error = np.median([row[2] for row in chosen])
            cells = [_cell(chosen, name) for name in ("hold_deg", "rise_s", "peak_rad_s", "lag_s")]
            print(
                f"| {kind} | {gain or 'all'} | {len(chosen)} | {error:.2f} | {' | '.join(cells)} |",
                flush=True,
            )


def _cell(rows: list[tuple[str, int, float, Figures, Figures]], name: str) -> str:
    pairs = np.array([[getattr(row[3], name), getattr(row[4], name)] for row in rows])
    if np.isnan(pairs).all():
        return ""
    simulated, measured = np.median(pairs, axis=0)
    off = np.median(np.abs(pairs[:, 0] - pairs[:, 1]))
    return f"{simulated:.3g} / {measured:.3g} ({off:.2g})"


def draw(model: str, logs: Logs, folder: Path) -> None:
    """Draw one log of each kind, simulated over measured."""
    from ikservo.cli.plots import new_figure, save_figure  # noqa: PLC0415 - only for pictures

    kinds, gains = np.unique(logs.trajectory), np.unique(logs.p_gain)
    usual = logs.p_gain == gains[len(gains) // 2]
    figure = new_figure(7.0, 2.0 * len(kinds))
    axes = figure.subplots(len(kinds), 1, sharex=True, squeeze=False)
    for axis, kind in zip(axes[:, 0], kinds, strict=True):
        of_kind = np.flatnonzero((logs.trajectory == kind) & usual)
        log = int(of_kind[len(of_kind) // 2])
        time_s = [ROW_S * row for row in range(logs.position_rad.shape[1])]
        axis.plot(time_s, np.degrees(logs.goal_rad[log][::SUBSTEPS]), "0.7", label="goal")
        axis.plot(time_s, np.degrees(logs.position_rad[log]), "k", label="measured")
        axis.plot(time_s, np.degrees(replay(model, logs, log)), "C1--", label="simulated")
        axis.set_ylabel(f"{kind}\nP = {logs.p_gain[log]:.0f}, degrees")
    axes[0, 0].legend(loc="upper right")
    axes[-1, 0].set_xlabel("seconds")
    save_figure(figure, folder / f"servosim-truth-{model.lower()}.png")


def main() -> None:
    """Replay, print and draw."""
    parser = argparse.ArgumentParser(description="Replay pendulum logs on simulated servos.")
    parser.add_argument("logs", type=Path, help="folder of the logs")
    parser.add_argument("--servo", choices=tuple(BENCHES), help="only this servo")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="only every N-th log")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER", help="draw into this folder")
    options = parser.parse_args()
    for model in (options.servo,) if options.servo else BENCHES:
        logs = BENCHES[model].read(options.logs)
        print_table(model, compare(model, logs, options.every))
        if options.pictures:
            draw(model, logs, options.pictures)


if __name__ == "__main__":
    main()
