"""Jitter of streamed goals, with the bus on a pseudo-terminal and a core kept busy.

Run ``python tools/bench/jitter.py``; the table goes to docs/benchmarks.md. It shows by how much the
time between two goals differs from the cycle time, and how many cycles were missed. The servos of
an arm have processors of their own: if permitted, the simulator has a higher priority than others.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import subprocess
import sys
import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

import ikservo
from ikservo.control.loop import ControlCycle, ControlLoop
from ikservo.motion import TrajectoryPoint

SERVE = (
    "import sys; from ikservo.cli.entry_point import console; sys.argv = sys.argv[1:]; console()"
)
SWING_RAD, PERIOD_S = 0.2, 4.0


class Swing:
    """A trajectory that moves one joint back and forth, with smooth ends."""

    def __init__(self, start: TrajectoryPoint, duration_s: float) -> None:
        self._start, self.duration_s = start, duration_s

    def state(self, time_s: float) -> TrajectoryPoint:
        """Return the joints (n,) at a time."""
        fraction = min(max(time_s / self.duration_s, 0.0), 1.0)
        soft = math.sin(math.pi * fraction) ** 2
        position = self._start.position.copy()
        position[0] += SWING_RAD * soft * math.sin(math.tau * time_s / PERIOD_S)
        return TrajectoryPoint.at_rest(position)


def busy() -> None:
    """Keep a core busy until the process is ended."""
    while True:
        math.sqrt(2.0)


@contextmanager
def load(count: int) -> Generator[None]:
    """Keep so many cores busy."""
    processes = [multiprocessing.Process(target=busy, daemon=True) for _ in range(count)]
    for process in processes:
        process.start()
    try:
        yield
    finally:
        for process in processes:
            process.terminate()


@contextmanager
def served(name: str) -> Generator[str]:
    """Serve an arm on a pseudo-terminal; yield its port."""
    with tempfile.TemporaryDirectory() as folder:
        link = str(Path(folder) / "arm")
        words = ["ikservo", "sim", name, "--link", link, "--pose", "home"]
        with subprocess.Popen(
            [sys.executable, "-c", SERVE, *words], stdout=subprocess.PIPE, text=True
        ) as server:
            assert server.stdout is not None  # it is a pipe
            server.stdout.readline()
            try:
                yield link
            finally:
                server.terminate()


def measure(port: str, name: str, rate_hz: float, duration_s: float) -> list[float]:
    """Return when each goal was sent, seconds."""
    sent_s: list[float] = []
    with ikservo.open_arm(name, port=port) as arm:
        arm.enable()
        servos = arm.context.servos
        clock = servos.clock

        def note(_: ControlCycle) -> None:
            sent_s.append(clock.now_s())

        trajectory = Swing(TrajectoryPoint.at_rest(servos.goals()), duration_s)
        ControlLoop(servos, 1.0 / rate_hz).run(trajectory, note, speed_rad_s=1.0)
    return sent_s


def words(title: str, sent_s: list[float], rate_hz: float) -> str:
    """Return one row of the table."""
    cycle_s = 1.0 / rate_hz
    gaps_ms = 1000.0 * np.abs(np.diff(sent_s) - cycle_s)
    missed = int(np.maximum(np.round(np.diff(sent_s) / cycle_s) - 1, 0).sum())
    p50, p99, p999 = np.percentile(gaps_ms, [50, 99, 99.9])
    return (
        f"| {title} | {len(sent_s)} | {p50:.2f} | {p99:.2f} | {p999:.2f} | {gaps_ms.max():.2f} "
        f"| {missed} |"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="How steady goals are streamed")
    parser.add_argument("--rate", type=float, default=200.0, help="Hz")
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--arm", action="append", help="so101 and koch if not given")
    options = parser.parse_args()
    print(f"| {options.rate:.0f} Hz | beats | p50 ms | p99 ms | p99.9 ms | worst ms | missed |")
    print("|---|---|---|---|---|---|---|")
    for name in options.arm or ["so101", "koch"]:
        for cores in (0, 1):
            with served(name) as port, load(cores):
                sent_s = measure(port, name, options.rate, options.seconds)
            print(words(f"{name}, {cores} cores busy", sent_s, options.rate), flush=True)


if __name__ == "__main__":
    main()
