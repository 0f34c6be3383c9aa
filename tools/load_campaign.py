"""Motions on a busy machine: a move, a line, a follow at 60 Hz and a search for the end stops.

Run ``python tools/load_campaign.py --runs 20 --load 6``: six busy processes run beside the
simulator, which is served on a pseudo-terminal in real time, and beside the program that moves the
arm. Each run is a program of its own, as a user starts it; it must end with exit code 0.
"""

from __future__ import annotations

import argparse
import math
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from served_arm import Served, forked, served

import ikservo
from ikservo.apps.calibrating.auto_calibration import probe_end_stop
from ikservo.apps.calibrating.range_tracker import ContactState
from ikservo.arm import Arm
from ikservo.arm.opening import open_own_arm
from ikservo.hardware.bus import ServoBus
from ikservo.kinematics.arrays import Vector

FOLLOW_S, RATE_HZ = 4.0, 60.0
AWAY_M = 0.04
SEARCHED = {"so101": "gripper", "koch": "gripper"}
Task = Callable[[Arm], bool]


def move(arm: Arm) -> bool:
    """Move the tip to a point and back."""
    return all(arm.move_to(point, speed="fast").reached for point in _there_and_back(arm))


def line(arm: Arm) -> bool:
    """Move the tip straight to a point and back."""
    return all(arm.move_line(point, speed="fast").reached for point in _there_and_back(arm))


def follow(arm: Arm) -> bool:
    """Follow setpoints on a circle at 60 Hz."""
    centre = arm.where().tip_m
    report = arm.follow(_circle(centre), speed="fast")
    well = report.ended == "end of the targets" and report.refused == 0
    if not well:
        print(f"follow: {report.ended}; {report.refused} refused: {report.reason}", flush=True)
    return well


def search(arm: Arm) -> bool:
    """Drive one joint gently towards its stop, as ``calibrate --auto`` does."""
    joint = SEARCHED[arm.model.name]
    context, bus = arm.context, _bus_of(arm)
    low, _ = context.limits()
    end = float(low[context.index.column(joint)])
    runner = arm.runner
    felt = probe_end_stop(context, runner, bus, joint, end, 0.3, lambda _: None)
    return felt.contact in (ContactState.STOP, ContactState.MOVING)


TASKS: dict[str, Task] = {"move": move, "line": line, "follow": follow, "search": search}


def _bus_of(arm: Arm) -> ServoBus:
    return vars(arm.context.servos)["_bus"]


def _there_and_back(arm: Arm) -> list[Vector]:
    here = arm.where().tip_m
    return [here + np.array([0.0, AWAY_M, 0.0]), here]


def _circle(centre: Vector) -> Iterator[Vector | None]:
    """Yield a setpoint whenever the next one is due at 60 Hz, else None."""
    begin_s, reported = time.monotonic(), -1
    while (now_s := time.monotonic() - begin_s) < FOLLOW_S:
        due = int(now_s * RATE_HZ)
        angle = math.tau * due / RATE_HZ / FOLLOW_S
        turned = np.array([0.0, math.sin(angle), 1.0 - math.cos(angle)])
        yield centre + 0.5 * AWAY_M * turned if due != reported else None
        reported = due


def attempt(arm: Served, task: Task) -> int:
    """Run a task in its own process; return its exit code: 0 success, 1 failure."""
    try:
        with open_own_arm(ikservo.load_model(arm.name), str(arm.port), collisions=False) as machine:
            machine.pose("home")
            machine.context.warm_up()
            return 0 if task(machine) else 1
    except ikservo.IkservoError as error:
        print(f"{arm.name}: {error}", file=sys.stderr, flush=True)
        return int(error.exit_code)


@contextmanager
def busy(count: int) -> Generator[None]:
    """Keep a number of processes busy until the block ends."""
    words = [sys.executable, "-c", "while True: pass"]
    processes = [subprocess.Popen(words) for _ in range(count)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def campaign(name: str, runs: int, load: int, wanted: list[str]) -> bool:
    """Run each task `runs` times; print how they ended, and return whether all ended well."""
    ikservo.load_model(name)  # loaded here, not in each forked child
    well = True
    with tempfile.TemporaryDirectory() as folder, served(name, Path(folder)) as arm, busy(load):
        for task in wanted:
            codes = Counter(_ended(arm, TASKS[task]) for _ in range(runs))
            loads = " ".join(f"{x:.1f}" for x in os.getloadavg())
            print(
                f"{name} {task}: {codes[0]} of {runs} ended well; exit codes {dict(codes)}; "
                f"{load} busy processes, load average {loads}",
                flush=True,
            )
            well = well and codes[0] == runs
    return well


def _ended(arm: Served, task: Task) -> int:
    _, status = os.waitpid(forked(lambda: attempt(arm, task), quiet=False), 0)
    return os.waitstatus_to_exitcode(status)


def run() -> int:
    """Run the tasks on both families."""
    parser = argparse.ArgumentParser(description="Run motions on a busy machine")
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--load", type=int, default=6, help="busy processes")
    parser.add_argument("--arm", action="append", help="default: so101 and koch")
    parser.add_argument("--task", action="append", choices=list(TASKS), help="default: all")
    options = parser.parse_args()
    names, tasks = options.arm or ["so101", "koch"], options.task or list(TASKS)
    well = [campaign(name, options.runs, options.load, tasks) for name in names]
    return 0 if all(well) else 1


if __name__ == "__main__":
    sys.exit(run())
