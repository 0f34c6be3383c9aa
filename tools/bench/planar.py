"""How the time of a solve grows with the number of joints: planar chains of n equal links.

Run ``python tools/bench/planar.py``; the table goes to docs/benchmarks.md.
"""

from __future__ import annotations

import math
import statistics
import time

import numpy as np

from ikservo.ik import Solver
from ikservo.kinematics import Chain, Joint, JointKind
from ikservo.kinematics.se3 import pose

SIZES = (3, 10, 30, 100, 1000)
TARGETS = 30
REACH_M = 1.0


def main() -> None:
    """Solve the same targets, as shares of the reach, with ever more and shorter links."""
    random = np.random.default_rng(1)
    radii, angles = random.uniform(0.2, 0.9, TARGETS), random.uniform(-2.0, 2.0, TARGETS)
    targets = np.column_stack([radii * np.cos(angles), radii * np.sin(angles)])
    print("| links | median | p95 | reached | of 3 links | of linear growth |")
    print("|---:|---:|---:|---:|---:|---:|")
    first_s = 0.0
    for n in SIZES:
        times_s, reached = _timed(n, targets)
        median_s = statistics.median(times_s)
        first_s = first_s or median_s
        p95_s = float(np.percentile(times_s, 95))
        ratio = median_s / first_s
        print(
            f"| {n} | {median_s * 1e6:.1f} µs | {p95_s * 1e6:.1f} µs | {reached}/{TARGETS} "
            f"| {ratio:.1f} × | {ratio * SIZES[0] / n:.2f} |"
        )


def _timed(n: int, targets: np.ndarray) -> tuple[list[float], int]:
    solver, bent = Solver(_planar(n)), np.full(n, 1.0 / n)
    T, out = np.eye(4), np.zeros(n)
    solver(T, bent, out)  # compiles, or loads what was compiled
    times_s: list[float] = []
    reached = 0
    for target in targets:
        T[:2, 3] = target
        started_s = time.perf_counter()
        _, met = solver(T, bent, out)
        times_s.append(time.perf_counter() - started_s)
        reached += met
    return times_s, reached


def _planar(n: int) -> Chain:
    z, length_m = np.array([0.0, 0.0, 1.0]), REACH_M / n
    joints = [
        Joint(f"j{i}", JointKind.REVOLUTE, f"l{i}", f"l{i + 1}",
              pose((length_m if i else 0.0, 0.0, 0.0)), z, -math.pi, math.pi)
        for i in range(n)
    ]  # fmt: skip
    end = Joint("end", JointKind.FIXED, f"l{n}", "tip", pose((length_m, 0.0, 0.0)), z)
    return Chain.from_joints([*joints, end], "l0", "tip")


if __name__ == "__main__":
    main()
