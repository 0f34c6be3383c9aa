"""optik-py: SLSQP over its own kinematics in Rust, with restarts of its own."""

# The package is not installed where types are checked, but in an environment of its own.
# pyright: basic, reportMissingImports=false

from __future__ import annotations

import numpy as np
from optik import Robot, SolverConfig
from protocol import Array, Problem, Solve, serve


def prepare(problem: Problem) -> Solve:
    """Give positions an orientation weight of zero; one thread, which the authors call exact."""
    problem.only("position", "pose")
    robot = Robot.from_urdf_file(problem.urdf, problem.base, problem.tip)
    robot.set_parallelism(1)
    turn = np.full(3, 0.0 if problem.kind == "position" else 1.0)
    config = SolverConfig(tol_f=problem.position_m**2, max_time=0.1, angular_weight=turn)

    def solve(T: Array, q0: Array) -> Array | None:
        answer = robot.ik(config, T, q0)
        return None if answer is None else np.array(answer[0])

    return solve


if __name__ == "__main__":
    serve("optik-py", prepare)
