"""Complete runs of ``calibrate --auto`` on a busy machine, one of them interrupted and resumed.

Run ``python tools/auto_campaign.py --load 6``: the arm is served with torque off on a
pseudo-terminal in real time, and so many busy processes run beside it. The first run starts from
the arm's rest and is interrupted while a joint is driven to its stop: it must end with 130 and keep
what it measured. A hand then moves the arm back into its pose; the second run must end with 0 and
measure only the others. With ``--whole`` nothing is interrupted.
"""

from __future__ import annotations

import argparse
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from load_campaign import busy
from served_arm import SERVE, Served, served

import ikservo
from ikservo.calibration.calibration_file import read_calibration
from ikservo.calibration.paths import calibration_path

STRONG = 60.0  # N m: enough to hold any arm
INTERRUPTED_AT, MOST_RUNS = 5, 5  # an end of the third joint; the maximum number of runs
SEARCHING, KEPT, LET_GO = ": searching", "They are not measured again", "Torque is on."


@dataclass(frozen=True)
class Run:
    """One command that has ended."""

    code: int
    lines: Sequence[str]
    duration_s: float

    def searched(self) -> int:
        """Return how many ends were searched."""
        return sum(SEARCHING in line for line in self.lines)


def calibrate(arm: Served, home: Path, interrupt_at: int | None = None) -> Run:
    """Run the command; press Ctrl-C during the search of the end of that number."""
    words = ["calibrate", arm.name, "--port", str(arm.port), "--auto", "--yes"]
    lines: list[str] = []
    begin_s = time.monotonic()
    with subprocess.Popen(
        [sys.executable, "-c", SERVE, "ikservo", *words],
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "IKSERVO_HOME": str(home)},
    ) as process:  # fmt: skip
        assert process.stderr is not None  # it is a pipe
        for line in process.stderr:
            lines.append(line.rstrip())
            print(f"  {time.monotonic() - begin_s:6.1f} s  {lines[-1]}", flush=True)
            if LET_GO in line:
                release(arm)
            if SEARCHING in line and sum(SEARCHING in each for each in lines) == interrupt_at:
                time.sleep(1.0)  # the search is under way
                process.send_signal(signal.SIGINT)
    code = 128 - process.returncode if process.returncode < 0 else process.returncode  # as shells
    return Run(code, lines, time.monotonic() - begin_s)


def hold_in_pose(arm: Served, pose: str = "rest") -> None:
    """Switch torque off, and let strong hands move the arm into a pose and hold it there."""
    words = ["relax", "--arm", arm.name, "--port", str(arm.port), "--yes"]
    subprocess.run([sys.executable, "-c", SERVE, "ikservo", *words], check=False)
    for joint, position in ikservo.load_model(arm.name).pose(pose).items():
        deg = math.degrees(position)
        arm.ask({"do": "hand", "joint": joint, "deg": deg, "force": STRONG, "speed": 5.0})
    time.sleep(3.0)


def release(arm: Served) -> None:
    """Remove the hands, if any."""
    for joint in ikservo.load_model(arm.name).joints:
        arm.ask({"do": "hand", "joint": joint.name, "release": True})


def campaign(name: str, load: int, *, whole: bool) -> bool:
    """Calibrate one arm; print the result of each joint, and return whether all is well.

    A run that fails is resumed, to show what was kept; all is well only if that was not needed.
    """
    with (
        tempfile.TemporaryDirectory() as folder,
        served(name, Path(folder), pose="rest") as arm,
        busy(load),
    ):
        home = Path(folder) / "home"
        runs = [calibrate(arm, home, interrupt_at=None if whole else INTERRUPTED_AT)]
        while runs[-1].code != 0 and len(runs) < MOST_RUNS:
            hold_in_pose(arm)
            runs.append(calibrate(arm, home))
        loads = " ".join(f"{x:.1f}" for x in os.getloadavg())
        print(
            f"{name}: exit codes {[run.code for run in runs]} "
            f"after {[round(run.duration_s) for run in runs]} s, "
            f"ends searched {[run.searched() for run in runs]}; "
            f"{load} busy processes, load average {loads}",
            flush=True,
        )
        well = [run.code for run in runs] == ([0] if whole else [130, 0])
        return all_known(name, home, runs[-1]) and well and (whole or reported(runs[-1]))


def reported(run: Run) -> bool:
    """Return whether a run continued from the measurements of another."""
    return any(KEPT in line for line in run.lines)


def all_known(name: str, home: Path, run: Run) -> bool:
    """Print how each joint was measured; return whether each was, or is named with a reason."""
    os.environ["IKSERVO_HOME"] = str(home)
    try:
        path = calibration_path(name, "")
        joints = read_calibration(path).joints if path.exists() else ()
    finally:
        del os.environ["IKSERVO_HOME"]
    well = bool(joints)
    for joint in joints:
        named = any(line.strip().startswith(f"{joint.name}: ") for line in run.lines)
        print(f"  {joint.name}: {joint.swept}, ticks {joint.travel_ticks}", flush=True)
        well = well and (joint.swept == "by itself" or named)
    return well


def run() -> int:
    """Calibrate arms of both families."""
    parser = argparse.ArgumentParser(description="Self-calibration on a busy machine")
    parser.add_argument("--load", type=int, default=6, help="busy processes")
    parser.add_argument("--arm", action="append", help="so101 and koch if not given")
    parser.add_argument("--whole", action="store_true", help="interrupt nothing")
    options = parser.parse_args()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # children of a shell may ignore it
    names = options.arm or ["so101", "koch"]
    well = [campaign(name, options.load, whole=options.whole) for name in names]
    return 0 if all(well) else 1


if __name__ == "__main__":
    sys.exit(run())
