"""Compare IkservoKinematics with LeRobot's RobotKinematics (placo) on the SO-101 in a table.

    make lerobot
    .venv-lerobot/bin/pip install placo
    .venv-lerobot/bin/python integrations/lerobot/tools/beside_placo.py

Targets: one call each from the home pose. Paths: the same targets, each reached by 50 calls along a
    straight line in joint space. Lines: 20 straight lines of the tip, 100 calls each. Each call
    starts from the previous result, as in LeRobot's processors. Both solvers get the same calls.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from lerobot.model.kinematics import RobotKinematics

import ikservo
from lerobot_robot_ikservo import IkservoKinematics

MODEL = ikservo.load_model("so101")
CHAIN = MODEL.chain
HOME = np.degrees(MODEL.chain_pose("home"))
LOWER, UPPER = np.degrees(CHAIN.lower_rad), np.degrees(CHAIN.upper_rad)


@dataclass
class Tally:
    """The results of the calls of one solver."""

    errors_m: list[float] = field(default_factory=list)
    outside: int = 0
    largest_step_deg: float = 0.0
    seconds: list[float] = field(default_factory=list)

    def call(self, solve: Callable, q: np.ndarray, T: np.ndarray) -> np.ndarray:
        """Solve once, and record limits, step and time."""
        begun_s = time.perf_counter()
        found = np.asarray(solve(q.copy(), T.copy()))
        self.seconds.append(time.perf_counter() - begun_s)
        self.outside += bool(np.any(found < LOWER - 0.01) or np.any(found > UPPER + 0.01))
        self.largest_step_deg = max(self.largest_step_deg, float(np.abs(found - q).max()))
        return found

    def note_error(self, q: np.ndarray, T: np.ndarray) -> None:
        """Record the distance of the tip from its target, by the same forward kinematics."""
        tip = CHAIN.forward(np.radians(q))[:3, 3]
        self.errors_m.append(float(np.linalg.norm(tip - T[:3, 3])))

    def row(self, what: str, solver: str) -> str:
        """Return a row of the table."""
        mm = np.array(self.errors_m) * 1000
        return (
            f"| {what} | {solver} | {np.median(mm):.2f} | {np.quantile(mm, 0.99):.1f} | "
            f"{100 * np.mean(mm < 1.0):.1f} % | {self.outside} of {len(self.seconds)} | "
            f"{self.largest_step_deg:.1f}° | {np.median(self.seconds) * 1e6:.0f} µs |"
        )


def targets(count: int) -> list[np.ndarray]:
    """Return joints (5,), degrees, whose poses are the targets."""
    rng = np.random.default_rng(20)
    return list(np.degrees(rng.uniform(CHAIN.lower_rad, CHAIN.upper_rad, (count, 5))))


def forward(q: np.ndarray) -> np.ndarray:
    """Return the pose (4, 4) at joints in degrees."""
    return CHAIN.forward(np.radians(q)).copy()


def run_targets(solve: Callable) -> Tally:
    """Solve each target once from home."""
    tally = Tally()
    for goal in targets(1000):
        T = forward(goal)
        tally.note_error(tally.call(solve, HOME, T), T)
    return tally


def run_paths(solve: Callable) -> Tally:
    """Solve 50 calls towards each target along a line in joint space."""
    tally = Tally()
    for goal in targets(1000):
        q = HOME
        for share in np.linspace(0.02, 1.0, 50):
            q = tally.call(solve, q, forward(HOME + share * (goal - HOME)))
        tally.note_error(q, forward(goal))
    return tally


def run_lines(solve: Callable) -> Tally:
    """Solve 20 straight lines of 12 cm with 100 calls each; every call counts."""
    tally, rng = Tally(), np.random.default_rng(21)
    start = forward(HOME)
    for _ in range(20):
        way = rng.normal(size=3)
        way *= 0.12 / np.linalg.norm(way)
        q = HOME
        for share in np.linspace(0.01, 1.0, 100):
            T = start.copy()
            T[:3, 3] += share * way
            q = tally.call(solve, q, T)
            tally.note_error(q, T)
    return tally


def main() -> None:
    """Print the table."""
    names = list(CHAIN.names)
    placo = RobotKinematics(str(MODEL.path.parent / "arm.urdf"), CHAIN.tip, names)
    own = IkservoKinematics("so101")
    shift = np.abs(placo.forward_kinematics(HOME) - own.forward_kinematics(HOME)).max()
    print(f"largest difference of the two forward kinematics at home: {shift:.1e}\n")
    print("| calls | solver | median mm | 99 % mm | below 1 mm | outside limits | "
          "largest joint step | time |\n|---|---|---|---|---|---|---|---|")  # fmt: skip
    for what, run in (("targets", run_targets), ("paths", run_paths), ("lines", run_lines)):
        for solver, kinematics in (("placo", placo), ("ikservo", own)):
            print(run(kinematics.inverse_kinematics).row(what, solver), flush=True)


if __name__ == "__main__":
    main()
