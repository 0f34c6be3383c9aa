"""Jitter of streamed goals, with the bus on a pseudo-terminal and a core kept busy.

Run ``python tools/bench/jitter.py``; the table goes to docs/benchmarks.md. It shows how late
control cycles begin, how much the time between two goals differs from the cycle time, and how many
cycles were missed, with ordinary and with real-time priority in turn. The latter needs root. Real
servos have processors of their own, so the simulator then has priority over the loop.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import multiprocessing
import os
import subprocess
import sys
import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import ikservo
from ikservo.arm.opening import open_own_arm
from ikservo.clock import RealClock
from ikservo.control import thread_priority
from ikservo.control.loop import ControlCycle, ControlLoop
from ikservo.errors import RefusedError
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
    """Keep a number of cores busy."""
    processes = [multiprocessing.Process(target=busy, daemon=True) for _ in range(count)]
    for process in processes:
        process.start()
    try:
        yield
    finally:
        for process in processes:
            process.terminate()


@contextmanager
def served(name: str) -> Generator[tuple[str, int]]:
    """Serve an arm on a pseudo-terminal; yield its port and the server's process id."""
    with tempfile.TemporaryDirectory() as folder:
        link = str(Path(folder) / "arm")
        words = ["ikservo", "sim", name, "--link", link, "--pose", "home"]
        with subprocess.Popen(
            [sys.executable, "-c", SERVE, *words], stdout=subprocess.PIPE, text=True
        ) as server:
            assert server.stdout is not None  # it is a pipe
            server.stdout.readline()
            try:
                yield link, server.pid
            finally:
                server.terminate()


class DueTimes(RealClock):
    """The machine's clock; records when each sleep should have ended, and when it did."""

    def __init__(self) -> None:
        self.late_s: list[float] = []

    def sleep_until(self, deadline_s: float) -> None:
        """Sleep, and record how late the sleep ended."""
        super().sleep_until(deadline_s)
        self.late_s.append(self.now_s() - deadline_s)


@dataclass(frozen=True)
class Timing:
    """Times of one motion: how late cycles began, when goals were sent, how long it takes [s]."""

    late_s: list[float]
    sent_s: list[float]
    duration_s: float


def measure(port: str, name: str, rate_hz: float, duration_s: float) -> Timing:
    """Stream goals for some time; return the times of the cycles."""
    clock, sent_s = DueTimes(), list[float]()
    with open_own_arm(ikservo.load_model(name), port) as arm:
        arm.enable()
        servos = arm.context.servos
        servos.clock = clock

        def note(_: ControlCycle) -> None:
            sent_s.append(clock.now_s())

        trajectory = Swing(TrajectoryPoint.at_rest(servos.goals()), duration_s)
        clock.late_s.clear()
        # A machine that is too busy brakes the motion; the measurements until then count.
        with contextlib.suppress(RefusedError):
            ControlLoop(servos, 1.0 / rate_hz).run(trajectory, note, speed_rad_s=1.0)
    return Timing(clock.late_s, sent_s, duration_s)


def words(title: str, timing: Timing, rate_hz: float) -> str:
    """Return one row of the table."""
    cycle_s, gaps_s = 1.0 / rate_hz, np.diff(timing.sent_s)
    missed = int(np.maximum(np.round(gaps_s / cycle_s) - 1, 0).sum())
    late_ms = 1000.0 * np.percentile(timing.late_s, [50, 99, 99.9, 100])
    off_ms = 1000.0 * np.percentile(np.abs(gaps_s - cycle_s), [50, 99, 99.9])
    figures = [*late_ms, *off_ms]
    if timing.sent_s[-1] - timing.sent_s[0] < 0.98 * timing.duration_s:
        title += ", stopped as the machine was too busy"
    return f"| {title} | {len(gaps_s) + 1} | {' | '.join(f'{x:.2f}' for x in figures)} | {missed} |"


@contextmanager
def real_time(priority: int, server_pid: int) -> Generator[None]:
    """Give control loops a priority, as if the user's limit allowed it; the servos get it, too."""
    before = thread_priority.allowed_priority
    thread_priority.allowed_priority = lambda: priority
    if priority:
        os.sched_setscheduler(server_pid, os.SCHED_FIFO, os.sched_param(priority + 1))
    try:
        yield
    finally:
        thread_priority.allowed_priority = before


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Measure how steadily goals are streamed")
    parser.add_argument("--rate", type=float, default=200.0, help="Hz")
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--arm", action="append", help="default: so101 and koch")
    parser.add_argument("--busy", type=int, nargs="+", default=[0, 1], help="cores kept busy")
    parser.add_argument("--priority", type=int, nargs="+", default=[0, 20], help="0: ordinary")
    options = parser.parse_args()
    print(f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores before it began")
    print(f"| {options.rate:.0f} Hz | cycles | begins late, p50 | p99 | p99.9 | most "
          "| between goals, beside the cycle: p50 | p99 | p99.9 ms | missed |")  # fmt: skip
    print("|---|" + "---:|" * 9)
    for name in options.arm or ["so101", "koch"]:
        for cores in options.busy:
            for priority in options.priority:
                title = f"{name}, {cores} cores kept busy, priority {priority or 'ordinary'}"
                with served(name) as (port, pid), load(cores), real_time(priority, pid):
                    timing = measure(port, name, options.rate, options.seconds)
                print(words(title, timing, options.rate), flush=True)


if __name__ == "__main__":
    main()
