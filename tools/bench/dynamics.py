"""How long the dynamics of an arm take, as a multiple of forward kinematics with the Jacobian.

Run ``OPENBLAS_NUM_THREADS=1 python tools/bench/dynamics.py``; the table goes to docs/benchmarks.md.
Many postures at once take longer where threads share busy cores.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

import ikservo
from ikservo.guard.sag import Weight, sag_of
from ikservo.kinematics.collision import CollisionBody
from ikservo.kinematics.dynamics import Dynamics
from ikservo.model.sag import link_masses

_MANY = 1000
_ROUNDS = 300
_COLUMNS = (
    "arm",
    "joints",
    "`forward` + `jacobian`, µs",
    "gravity",
    "inverse dynamics",
    "inertia matrix",
    "regressor",
    "inverse dynamics, µs",
    "gravity, µs a posture of 1,000",
    "the guard's, µs a posture of 1,000",
)


def main() -> None:
    """Time the dynamics of each arm and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", nargs="+", default=ikservo.arm_names(), metavar="ARM")
    print("| " + " | ".join(_COLUMNS) + " |")
    print("|---|" + "---:|" * (len(_COLUMNS) - 1))
    for name in parser.parse_args().arms:
        print(_row(ikservo.load_model(name)))


def _row(model: ikservo.Model) -> str:
    chain = model.chain
    masses = link_masses(model, chain)
    ours = Dynamics.from_masses(chain, masses)
    random = np.random.default_rng(1)
    many = random.uniform(chain.lower_rad, chain.upper_rad, (_MANY, chain.dof))
    q, qd, qdd = many[0], *random.normal(size=(2, chain.dof))
    calls: list[Callable[[], object]] = [
        lambda: (chain.forward(q), chain.jacobian(q)),
        lambda: ours.gravity_torques(q),
        lambda: ours.inverse_dynamics(q, qd, qdd),
        lambda: ours.inertia_matrix(q),
        lambda: ours.regressor(q, qd, qdd),
    ]
    base_us, *times_us = _median_times_us(calls, _ROUNDS)
    sag = sag_of(
        CollisionBody(chain, []),
        Weight(masses, np.ones(chain.dof), np.full(chain.dof, -np.inf), np.full(chain.dof, np.inf)),
    )
    many_us = _median_times_us([lambda: ours.gravity_torques(many), lambda: sag(many)], 20) / _MANY
    cells = [model.name, str(chain.dof), f"{base_us:.0f}"]
    cells += [f"{each / base_us:.2f} ×" for each in times_us]
    cells += [f"{times_us[1]:.0f}", *(f"{each:.2f}" for each in many_us)]
    return "| " + " | ".join(cells) + " |"


def _median_times_us(calls: list[Callable[[], object]], rounds: int) -> NDArray[np.float64]:
    """Return the median time of each call [µs]; they take turns, so that all see the same load."""
    times_s = np.empty((rounds, len(calls)))
    for call in calls:
        call()
    for row in times_s:
        for i, call in enumerate(calls):
            started_s = time.perf_counter()
            call()
            row[i] = time.perf_counter() - started_s
    return 1e6 * np.median(times_s, axis=0)


if __name__ == "__main__":
    main()
