"""Compare our solver with other versions and peers in alternating rounds; the best round counts.

    python tools/bench/alternating.py --versions numba=PYTHON --peers roboticstoolbox optik

PYTHON is the interpreter of another version of ikservo; the table goes to docs/benchmarks.md. A
round starts every solver once with the same targets, so that a slow minute of the machine affects
all; the table has the smallest median, percentile and batch time of all rounds.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from environments import PEERS, interpreter_for
from judging import solved
from problems import KINDS, problem_of, rounds_of

import ikservo

_RUNNERS = Path(__file__).parent / "peers"
_OURS = "ikservo"


@dataclass
class Contestant:
    """A solver and its best figures so far: times [µs] by kind, solves per second, success."""

    name: str
    interpreter: Path
    runner: Path
    times_us: dict[str, float] = field(default_factory=dict[str, float])
    batch_hz: float = 0.0
    success: float = 1.0


def main() -> None:
    """Run the rounds of every arm and kind, and print a table."""
    options = _options()
    print("| arm | target | solver | home, median | p90 | p99 | near | line | batch/s | success |")
    print("|---|---|---|---:|---:|---:|---:|---:|---:|---:|")
    for arm in options.arms:
        model = ikservo.load_model(arm)
        for kind in options.kinds:
            targets = rounds_of(model, kind, options.targets, options.lines, options.seed)
            request = {"problem": problem_of(model, kind), "rounds": targets, "budget_s": 60.0}
            solvers = _contestants(options)
            for _ in range(options.rounds):
                solvers = [each for each in solvers if _ask(each, model, kind, request)]
            _print_rows(f"| {arm} ({model.chain.dof}) | {kind} ", solvers)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--arms", nargs="+", default=["so101", "wx250s", "vx300s"], metavar="ARM")
    parser.add_argument("--kinds", nargs="+", default=["position", "pose"], choices=KINDS)
    parser.add_argument("--versions", nargs="*", default=[], metavar="NAME=PYTHON")
    names = [peer.name for peer in PEERS if peer.name != _OURS]
    parser.add_argument("--peers", nargs="*", default=[], choices=names, metavar="PEER")
    parser.add_argument("--targets", type=int, default=1000)
    parser.add_argument("--lines", type=int, default=1, help="lines of 1,000 points each")
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--seed", type=int, default=1)
    return parser.parse_args()


def _contestants(options: argparse.Namespace) -> list[Contestant]:
    """Return our solver, then the other versions, then the peers."""
    ours = _RUNNERS / "run_ikservo.py"
    found = [Contestant(_OURS, Path(sys.executable), ours)]
    for version in options.versions:
        name, interpreter = version.split("=", 1)
        found.append(Contestant(name, Path(interpreter), ours))
    peers = [peer for peer in PEERS if peer.name in options.peers]
    return found + [Contestant(p.name, interpreter_for(p), _RUNNERS / p.runner) for p in peers]


def _ask(solver: Contestant, model: ikservo.Model, kind: str, request: dict[str, Any]) -> bool:
    """Run one round of a solver and keep its best figures; False if it has no such targets."""
    done = subprocess.run(
        [str(solver.interpreter), str(solver.runner)],
        input=json.dumps(request),
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
    )
    answer = json.loads(done.stdout)
    if "cannot" in answer:
        return False
    for name, part in answer["rounds"].items():
        for percent in (50, 90, 99):
            time_us = 1e6 * float(np.percentile(part["time_s"], percent))
            key = f"{name} {percent}"
            solver.times_us[key] = min(time_us, solver.times_us.get(key, time_us))
    home = answer["rounds"]["home"]["q"]
    hits = solved(model.chain, kind, request["rounds"]["home"], home)[: len(home)]
    solver.success = min(solver.success, float(hits.mean()))
    solver.batch_hz = max(solver.batch_hz, answer["batch"]["rate_hz"] if answer["batch"] else 0.0)
    return True


def _print_rows(start: str, solvers: list[Contestant]) -> None:
    """Print one row per solver; in brackets, how many times as fast ours is."""
    ours = solvers[0]
    for solver in solvers:
        cells: list[str] = []
        for key in ("home 50", "home 90", "home 99", "near 50", "line 50"):
            time_us = solver.times_us.get(key)
            ratio = (
                "" if solver is ours or not time_us else f" ({time_us / ours.times_us[key]:.1f})"
            )
            cells.append(f"{time_us:.2f}{ratio}" if time_us else "–")
        rate = f"{solver.batch_hz:,.0f}" if solver.batch_hz else "–"
        cells += [rate, f"{100.0 * solver.success:.4g} %"]
        print(f"{start}| {solver.name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
