"""Our solver beside other versions of itself: the same targets, in turns, in one run.

Run ``python tools/bench/versions.py old=PATH new=PATH`` with the trees of two versions or more; the
table goes to docs/benchmarks.md. A round starts one process for each, and the best round counts.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

import ikservo
from ikservo.ik.prepare import TargetKindName
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector

_ARMS = ("so101", "wx250s")
_KINDS = ("position", "pose")
_TARGETS, _BATCH = 1000, 20_000

Times = dict[str, list[float]]
"""Median, 90th and 99th percentile [µs] of each task."""


def main() -> None:
    """Time all versions in turns and print the best round of each."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("trees", nargs="*", metavar="NAME=PATH")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--measure", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.measure:
        print(json.dumps(_measure()))
        return
    trees = dict(tree.split("=", 1) for tree in given.trees)
    best: dict[str, Times] = {name: {} for name in trees}
    for _ in range(given.rounds):
        for name, path in trees.items():
            for task, times_us in _measure_in(Path(path).resolve()).items():
                before = best[name].get(task, times_us)
                best[name][task] = [min(pair) for pair in zip(before, times_us, strict=True)]
    _print_table(best)


def _measure_in(tree: Path) -> Times:
    """Run the measurement on the package of another tree."""
    path = os.pathsep.join([str(tree), str(tree / "sim")])
    command = [sys.executable, "-P", __file__, "--measure"]
    environment = os.environ | {"PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1"}
    return json.loads(subprocess.check_output(command, env=environment, text=True))


def _print_table(best: dict[str, Times]) -> None:
    first = next(iter(best.values()))
    print("| task | " + " | ".join(f"{name}, µs (p90, p99)" for name in best) + " | ratio |")
    print("|---|" + "---:|" * (len(best) + 1))
    for task, base in first.items():
        cells = ["{:.2f} ({:.1f}, {:.1f})".format(*times[task]) for times in best.values()]
        last = list(best.values())[-1][task]
        print(f"| {task} | " + " | ".join(cells) + f" | {base[0] / last[0]:.2f} |")


def _measure() -> Times:
    """Time this version's solver on targets that are the same for every version."""
    found: Times = {}
    for name in _ARMS:
        model = ikservo.load_model(name)
        chain, q0 = model.chain, model.chain_pose("home")
        rng = np.random.default_rng(1)
        poses = chain.forward(rng.uniform(chain.lower_rad, chain.upper_rad, (_BATCH, chain.dof)))
        for kind in _KINDS:
            found |= _prepared(f"{name}, {kind}", chain, kind, q0, poses)
            solve = partial(_solve_target, chain, kind, q0)
            found[f"{name}, {kind}, solve()"] = _percentiles(solve, poses[:_TARGETS])
    return found


def _prepared(what: str, chain: Chain, kind: TargetKindName, q0: Vector, poses: Matrix) -> Times:
    """Time a prepared solver from one start, along a line, and on many targets at once."""
    solver, out = ikservo.Solver(chain, kind), np.empty(chain.dof)
    q = 0.5 * (chain.lower_rad + chain.upper_rad)
    line = chain.forward(np.linspace(q + 0.1, q + 0.4, _TARGETS))
    found = {
        f"{what}, from home": _percentiles(lambda T: solver(T, q0, out), poses[:_TARGETS]),
        f"{what}, tracking": _percentiles(lambda T: solver.track(T, q, q), line),
    }
    started_s = time.perf_counter()
    ikservo.solve_batch(chain, poses, q0, kind=kind)
    found[f"{what}, batch, each"] = [1e6 * (time.perf_counter() - started_s) / _BATCH] * 3
    return found


def _solve_target(chain: Chain, kind: TargetKindName, q0: Vector, T: Matrix) -> None:
    """Solve with a new target, of which the result is an object, too."""
    target = ikservo.Target(T[:3, 3], orientation=T[:3, :3] if kind == "pose" else None)
    ikservo.solve(chain, target, q0, nearest=False)


def _percentiles(run: Callable[[Matrix], object], poses: Matrix) -> list[float]:
    run(poses[0])
    times_s: list[float] = []
    for T in poses:
        started_s = time.perf_counter()
        run(T)
        times_s.append(time.perf_counter() - started_s)
    return [1e6 * float(x) for x in np.percentile(times_s, [50, 90, 99])]


if __name__ == "__main__":
    main()
