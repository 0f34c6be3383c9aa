"""How our solver's time grows with the number of joints: planar chains, one metre long.

Run ``python tools/bench/growth.py``; the table goes to docs/benchmarks.md.
"""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

import ikservo
from ikservo.kinematics import Joint, JointKind
from ikservo.kinematics.se3 import pose

JOINTS = (3, 10, 30, 100, 1000)
_LIMIT_RAD = 2.0
_BUDGET_S = 4.0
_MOST_TARGETS = 200


def main() -> None:
    """Time the prepared solver and the convenience call on each chain."""
    print("| joints | prepared solver, median µs | of 3 joints | reached | `solve()`, median µs |")
    print("|---:|---:|---:|---:|---:|")
    base_us = 0.0
    for count in JOINTS:
        chain = _planar(count)
        prepared_us, reached = _prepared(chain)
        base_us = base_us or prepared_us
        print(
            f"| {count} | {prepared_us:,.1f} | {prepared_us / base_us:,.1f} × | {reached:.0%} "
            f"| {_convenient(chain):,.1f} |"
        )


def _planar(count: int) -> ikservo.Chain:
    """Return a chain of equal links that turn about z, from l0 to the tip."""
    length_m = 1.0 / count
    joints = [
        Joint(
            name=f"j{i}",
            kind=JointKind.REVOLUTE,
            parent=f"l{i}",
            child=f"l{i + 1}",
            origin=pose((length_m if i else 0.0, 0.0, 0.0)),
            axis=np.array([0.0, 0.0, 1.0]),
            lower=-_LIMIT_RAD,
            upper=_LIMIT_RAD,
        )
        for i in range(count)
    ]
    end = pose((length_m, 0.0, 0.0))
    fixed = Joint("end", JointKind.FIXED, f"l{count}", "tip", end, np.array([0.0, 0.0, 1.0]))
    return ikservo.Chain.from_joints([*joints, fixed], "l0", "tip")


def _targets(chain: ikservo.Chain) -> NDArray[np.float64]:
    """Return reachable poses (n, 4, 4): chains bent evenly, each to another degree and side."""
    rng = np.random.default_rng(1)
    bend = rng.uniform(-3.0, 3.0, (_MOST_TARGETS, 1)) / chain.dof
    wiggle = rng.uniform(-0.5, 0.5, (_MOST_TARGETS, chain.dof)) / np.sqrt(chain.dof)
    return chain.forward(chain.clip(bend + wiggle))


def _prepared(chain: ikservo.Chain) -> tuple[float, float]:
    solver, start = ikservo.Solver(chain, "position"), _start(chain)
    solver(_targets(chain)[0], start)
    times_s: list[float] = []
    hits: list[bool] = []
    ends_s = time.perf_counter() + _BUDGET_S
    for T in _targets(chain):
        started_s = time.perf_counter()
        _, reached = solver(T, start)
        times_s.append(time.perf_counter() - started_s)
        hits.append(reached)
        if time.perf_counter() > ends_s:
            break
    return float(np.median(times_s)) * 1e6, float(np.mean(hits))


def _convenient(chain: ikservo.Chain) -> float:
    start = _start(chain)
    ikservo.solve(chain, ikservo.Target(_targets(chain)[0, :3, 3]), start)
    times_s: list[float] = []
    ends_s = time.perf_counter() + _BUDGET_S
    for T in _targets(chain):
        started_s = time.perf_counter()
        ikservo.solve(chain, ikservo.Target(T[:3, 3]), start)
        times_s.append(time.perf_counter() - started_s)
        if time.perf_counter() > ends_s:
            break
    return float(np.median(times_s)) * 1e6


def _start(chain: ikservo.Chain) -> NDArray[np.float64]:
    """Return joints (dof,) that curl a little: straight is where every planar arm is singular."""
    return np.full(chain.dof, 1.0 / chain.dof)


if __name__ == "__main__":
    main()
