"""Compare the oscillation of unloaded servos at high gains: logs of real and simulated ones.

Run ``python tools/bench/limit_cycle.py LOGS [--every N]`` with the folder of the logs that
``tools/identify_motor.py`` reads. After a step back to where the pendulum hangs, the logs are
judged at their end: which of them oscillate, with what peak-to-peak amplitude and frequency. The
same steps are replayed on the simulated line with the servo as in the table, without backlash, and
with the output friction of an arm. Figures belong in docs/lab/simulated-motors.md.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from motor_truth import BENCHES, ROW_S, Array, replay

from servosim.parameters import PARAMETERS, MotorParameters, in_an_arm

TICK_RAD = 2.0 * math.pi / 4096
MODELS = ("STS3215-C018", "STS3250")
GAINS = (8, 16, 24, 32)
END = slice(500, 598)  # rows after the step back
LEAST_DEG = 0.2  # from peak to peak: more than two ticks are an oscillation
LARGEST_DEG = 3.5  # a larger motion is a step that has not ended, or a failed reading
PADDED_ROWS = 2048

SERVOS: dict[str, Callable[[MotorParameters], MotorParameters]] = {
    "as in the table": lambda motor: motor,
    "without play": lambda motor: replace(motor, backlash_rad=0.0),
    "in an arm": in_an_arm,
}


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
    parser.add_argument("--every", type=int, default=1, metavar="N", help="only every N-th log")
    options = parser.parse_args()
    for model in MODELS:
        logs = BENCHES[model].read(options.logs)
        logs = logs.select(logs.trajectory == "brutal")
        logs = logs.select(np.arange(len(logs.name)) % options.every == 0)
        print(f"\n| {model} | " + " | ".join(f"P = {gain}" for gain in GAINS) + " |")
        print("|---|" + "---:|" * len(GAINS))
        rows = {"measured": logs.position_rad}
        for name, build in SERVOS.items():
            motor = build(PARAMETERS[model])
            found = [replay(model, logs, k, motor) for k in range(len(logs.name))]
            rows[name] = np.stack(found)
        for name, position in rows.items():
            cells = [_cell(position[logs.p_gain == gain]) for gain in GAINS]
            print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
