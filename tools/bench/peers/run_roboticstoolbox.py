"""roboticstoolbox-python: ``ETS.ik_LM``, Levenberg-Marquardt in C++ with restarts of its own."""

# The package is not installed where types are checked, but in an environment of its own.
# pyright: basic, reportMissingImports=false

from __future__ import annotations

import numpy as np
from protocol import Array, Problem, Solve, serve
from roboticstoolbox import ERobot


def prepare(problem: Problem) -> Solve:
    """Mask the orientation for positions; directions need weights in tool axes: not supported."""
    problem.only("position", "pose")
    ets = ERobot.URDF(problem.urdf).ets(end=problem.tip)
    mask = np.array([1, 1, 1, 0, 0, 0] if problem.kind == "position" else [1] * 6, dtype=float)
    residual = 0.5 * problem.position_m**2

    def solve(T: Array, q0: Array) -> Array | None:
        answer = ets.ik_LM(T, q0=q0, tol=residual, mask=mask, joint_limits=True)
        return answer.q if answer.success else None

    return solve


if __name__ == "__main__":
    serve("roboticstoolbox-python", prepare)
