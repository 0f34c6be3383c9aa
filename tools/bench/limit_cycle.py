"""Oscillation of unloaded servos at high gains: logs of real ones, and gears with play.

Run ``python tools/bench/limit_cycle.py LOGS`` with the folder of the logs that
``tools/identify_motor.py`` reads. After a step back to where the pendulum hangs, the logs are
judged at their end: which of them oscillate, by how much from peak to peak, and how fast.
Beside them is a model with two bodies: rotor and gears with the friction of the motor, and the
pendulum, which is free inside the play and meets the gears without a rebound. Motor, friction
and duty law are those of ``servosim``; only the play is sought. Figures belong in
docs/servosim-truth.md.
"""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1]))

from identify_motor import (
    BENCHES,
    DISC_M2,
    GRAVITY_M_S2,
    ROD_KG,
    ROW_S,
    SUBSTEPS,
    TICK_RAD,
    Firmware,
    Logs,
    duty_of,
    step_reference,
)

from servosim.parameters import PARAMETERS, MotorParameters

Array = NDArray[np.float64]

MODELS = ("STS3215-C018", "STS3250")
GAINS = (4, 8, 12, 16, 24, 32)
PLAYS_DEG = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.2, 1.4)
SLICES = 10  # steps of the model in a step of the logs' goals
END = slice(500, 598)  # rows after the step back
LEAST_DEG = 0.2  # from peak to peak: more than two ticks are an oscillation
LARGEST_DEG = 3.5  # more is a step that has not ended, or a reading that failed
PADDED_ROWS = 2048


@dataclass
class Gears:
    """Gears with play in front of hanging pendulums, one for each log.

    Attributes:
        motor: The servo.
        inertia: Of the pendulums (logs,) [kg m²].
        weight_nm: Torque of their weights at a right angle (logs,).
        half_rad: Half of the play.
        gear_rad: Angle of the gears (logs,).
        shaft_rad: Angle of the output shafts (logs,).
        gear_rad_s: Speed of the gears.
        shaft_rad_s: Speed of the shafts.
        side: The flank of a tooth that a shaft is on: 1 ahead of the gears, -1 behind, 0 between.
    """

    motor: MotorParameters
    inertia: Array
    weight_nm: Array
    half_rad: float
    gear_rad: Array
    shaft_rad: Array
    gear_rad_s: Array
    shaft_rad_s: Array
    side: Array

    @classmethod
    def at_rest(cls, motor: MotorParameters, logs: Logs, play_rad: float) -> Gears:
        """Return gears and shafts at rest where each log begins."""
        square = logs.length_m**2
        inertia = logs.mass_kg * (square + DISC_M2) + ROD_KG * square / 3.0
        weight_nm = GRAVITY_M_S2 * logs.length_m * (logs.mass_kg + ROD_KG / 2.0)
        start, still = logs.position_rad[:, 0], np.zeros(len(inertia))
        side = np.where(play_rad > 0.0, still, 1.0)
        return cls(
            motor, inertia, weight_nm, play_rad / 2.0, start.copy(), start.copy(), still.copy(),
            still.copy(), side,
        )  # fmt: skip

    def step(self, dt_s: float, drive_nm: Array) -> None:
        """Advance under the torque of blocked motors (logs,)."""
        m = self.motor
        back_emf = m.torque_constant_nm_a**2 / m.resistance_ohm
        most_nm = m.torque_constant_nm_a * m.current_limit_a
        pressed_nm = np.clip(drive_nm - back_emf * self.gear_rad_s, -most_nm, most_nm)
        load_nm = -self.weight_nm * np.sin(self.shaft_rad)
        on = self.side != 0.0
        carried = np.where(on, self.inertia, 0.0)
        geared_nm = np.where(on, load_nm, 0.0)
        gear_after = _slid(m, dt_s, carried, pressed_nm, geared_nm, self.gear_rad_s, back_emf)
        pushed_nm = self.inertia * (gear_after - self.shaft_rad_s) / dt_s - load_nm
        leaves = on & (self.side * pushed_nm > 0.0) & (self.half_rad > 0.0)
        alone = _slid(m, dt_s, 0.0, pressed_nm, 0.0 * load_nm, self.gear_rad_s, back_emf)
        free = ~on | leaves
        self.side[leaves] = 0.0
        falling = self.shaft_rad_s + dt_s * load_nm / self.inertia
        self.gear_rad_s = np.where(free, alone, gear_after)
        self.shaft_rad_s = np.where(free, falling, gear_after)
        self.gear_rad += dt_s * self.gear_rad_s
        self.shaft_rad += dt_s * self.shaft_rad_s
        self._meet(free)

    def _meet(self, free: NDArray[np.bool_]) -> None:
        """Let shafts that have crossed the play meet the gears: one speed, no rebound."""
        lash = self.shaft_rad - self.gear_rad
        met = free & (np.abs(lash) >= self.half_rad)
        self.side[met] = np.sign(lash[met])
        armature = self.motor.armature_kg_m2
        momentum = armature * self.gear_rad_s + self.inertia * self.shaft_rad_s
        common = momentum / (armature + self.inertia)
        self.gear_rad_s[met] = self.shaft_rad_s[met] = common[met]
        self.gear_rad[met] = (self.shaft_rad - self.side * self.half_rad)[met]


def _slid(
    m: MotorParameters, dt_s: float, carried: Array | float, pressed_nm: Array, load_nm: Array,
    speed: Array, back_emf: float,
) -> Array:  # fmt: skip
    """Return speeds after a step; dry friction as in `servosim.motor`."""
    inertia = m.armature_kg_m2 + carried + dt_s * (back_emf + m.viscous_nm_s)
    gear_nm = np.abs(pressed_nm - load_nm)
    dry_nm = m.friction_nm + gear_nm * (m.load_friction + m.load_square_per_nm * gear_nm)
    slowness = np.exp(-np.abs(speed) / m.stribeck_rad_s)
    dry_nm = dry_nm + slowness * (m.stribeck_nm + m.load_stribeck * gear_nm)
    after = speed + dt_s / inertia * (pressed_nm + load_nm - m.viscous_nm_s * speed)
    stopped: Array = np.maximum(np.abs(after) - dt_s / inertia * dry_nm, 0.0)
    return np.sign(after) * stopped


def simulate(motor: MotorParameters, firmware: Firmware, logs: Logs, play_rad: float) -> Array:
    """Return the positions of the output shafts [rad], shape (logs, rows)."""
    gears, out = Gears.at_rest(motor, logs, play_rad), np.empty_like(logs.position_rad)
    full_nm = motor.torque_constant_nm_a / motor.resistance_ohm * logs.supply_v
    reference, dt_s = logs.position_rad[:, 0].copy(), ROW_S / SUBSTEPS
    for k in range(out.shape[1] * SUBSTEPS):
        if k % SUBSTEPS == 0:
            out[:, k // SUBSTEPS] = gears.shaft_rad
        reference = step_reference(reference, logs.goal_rad[:, k], firmware.ramp_rad_s * dt_s)
        drive_nm = full_nm * duty_of(reference - gears.shaft_rad, firmware, logs.p_gain)
        for _ in range(SLICES):
            gears.step(dt_s / SLICES, drive_nm)
    return out


def judge(position_rad: Array) -> tuple[Array, Array]:
    """Return peak to peak [degrees] and frequency [Hz] of each log at its end."""
    end = np.rint(position_rad[:, END] / TICK_RAD) * math.degrees(TICK_RAD)
    swing = end - end.mean(axis=1, keepdims=True)
    spectrum = np.abs(np.fft.rfft(swing * np.hanning(swing.shape[1]), PADDED_ROWS))
    hertz: Array = np.asarray(np.fft.rfftfreq(PADDED_ROWS, ROW_S), dtype=np.float64)
    spectrum[:, hertz < 1.0] = 0.0
    return np.ptp(end, axis=1), hertz[spectrum.argmax(axis=1)]


def _cell(position_rad: Array) -> str:
    peaks_deg, hertz = judge(position_rad)
    whole = peaks_deg < LARGEST_DEG
    swings = whole & (peaks_deg > LEAST_DEG)
    share = f"{int(swings.sum())} of {int(whole.sum())}"
    if not swings.any():
        return share
    return f"{share}, {np.median(peaks_deg[swings]):.2f}°, {np.median(hertz[swings]):.1f} Hz"


def main() -> None:
    """Print a table for each model."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("logs", type=Path)
    parser.add_argument("--plays-deg", type=float, nargs="+", default=PLAYS_DEG)
    options = parser.parse_args()
    for model in MODELS:
        bench = BENCHES[model]
        logs = bench.read(options.logs)
        logs = logs.select(logs.trajectory == "brutal")
        print(f"\n| {model} | " + " | ".join(f"P = {gain}" for gain in GAINS) + " |")
        print("|---|" + "---:|" * len(GAINS))
        rows = {"measured": logs.position_rad}
        for play_deg in options.plays_deg:
            play_rad = math.radians(play_deg)
            rows[f"play {play_deg:g}°"] = simulate(
                PARAMETERS[model], bench.firmware, logs, play_rad
            )
        for name, position in rows.items():
            cells = [_cell(position[logs.p_gain == gain]) for gain in GAINS]
            print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
