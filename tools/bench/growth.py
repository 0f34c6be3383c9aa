"""Measure how our solver's time grows with the joints of planar chains, one metre long.

Run ``python tools/bench/growth.py``; the table goes to docs/benchmarks.md.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

import ikservo
from ikservo.kinematics import Joint, JointType
from ikservo.kinematics.se3 import make_pose

JOINTS = (3, 10, 30, 100, 1000)
_LIMIT_RAD = 2.0
_BUDGET_S = 4.0
_TARGETS = 200


def main() -> None:
    """Time the prepared solver and the convenience call on each chain."""
    print(
        "| joints | prepared solver, median µs | p95 µs | of 3 joints | of linear growth | reached "
        "| tracking, median µs | `solve(nearest=False)`, median µs |"
    )
    print("|---:|---:|---:|---:|---:|---:|---:|---:|")
    base_us = 0.0
    for count in JOINTS:
        chain = _planar(count)
        times_us, reached = _prepared(chain)
        median_us = float(np.median(times_us))
        base_us = base_us or median_us
        ratio = median_us / base_us
        print(
            f"| {count} | {median_us:,.1f} | {np.percentile(times_us, 95):,.1f} | {ratio:,.1f} × "
            f"| {ratio * JOINTS[0] / count:.2f} | {reached:.0%} | {_tracked(chain):,.1f} "
            f"| {_convenient(chain):,.1f} |"
        )


def _planar(count: int) -> ikservo.Chain:
    """Return a chain of equal links that rotate about z, from l0 to the tip."""
    length_m = 1.0 / count
    joints = [
        Joint(
            name=f"j{i}",
            kind=JointType.REVOLUTE,
            parent=f"l{i}",
            child=f"l{i + 1}",
            origin=make_pose((length_m if i else 0.0, 0.0, 0.0)),
            axis=np.array([0.0, 0.0, 1.0]),
            lower=-_LIMIT_RAD,
            upper=_LIMIT_RAD,
        )
        for i in range(count)
    ]
    end = make_pose((length_m, 0.0, 0.0))
    fixed = Joint("end", JointType.FIXED, f"l{count}", "tip", end, np.array([0.0, 0.0, 1.0]))
    return ikservo.Chain.from_joints([*joints, fixed], "l0", "tip")


def _targets() -> NDArray[np.float64]:
    """Return poses (n, 4, 4) at the same points for every chain, near the base and far away."""
    rng = np.random.default_rng(1)
    radius_m, angle_rad = rng.uniform(0.2, 0.9, _TARGETS), rng.uniform(-2.0, 2.0, _TARGETS)
    poses = np.tile(np.eye(4), (_TARGETS, 1, 1))
    poses[:, 0, 3], poses[:, 1, 3] = radius_m * np.cos(angle_rad), radius_m * np.sin(angle_rad)
    return poses


def _prepared(chain: ikservo.Chain) -> tuple[NDArray[np.float64], float]:
    """Return the times [µs] and the fraction of targets reached."""
    solver, start = ikservo.Solver(chain, "position"), _start(chain)
    return _timed(lambda T: solver(T, start)[1])


def _tracked(chain: ikservo.Chain) -> float:
    """Return the median time [µs] of steps along a path that stays inside the limits."""
    solver, start = ikservo.Solver(chain, "position"), _start(chain)
    path = chain.forward(np.linspace(start, 2.0 * start, _TARGETS))
    return float(np.median(_timed(lambda T: solver.track(T, start, start)[1], path)[0]))


def _convenient(chain: ikservo.Chain) -> float:
    """Return the median time [µs] with targets and results as objects."""
    start = _start(chain)

    def ask(T: NDArray[np.float64]) -> bool:
        return ikservo.solve(chain, ikservo.Target(T[:3, 3]), start, nearest=False).reached

    return float(np.median(_timed(ask)[0]))


def _timed(
    ask: Callable[[NDArray[np.float64]], bool], poses: NDArray[np.float64] | None = None
) -> tuple[NDArray[np.float64], float]:
    targets = _targets() if poses is None else poses
    ask(targets[0])  # compiles the kernels, or loads compiled ones
    times_s: list[float] = []
    hits: list[bool] = []
    ends_s = time.perf_counter() + _BUDGET_S
    for T in targets:
        started_s = time.perf_counter()
        reached = ask(T)
        times_s.append(time.perf_counter() - started_s)
        hits.append(reached)
        if time.perf_counter() > ends_s:
            break
    return np.array(times_s) * 1e6, float(np.mean(hits))


def _start(chain: ikservo.Chain) -> NDArray[np.float64]:
    """Return slightly bent joints (dof,), because a straight planar arm is singular."""
    return np.full(chain.dof, 1.0 / chain.dof)


if __name__ == "__main__":
    main()
