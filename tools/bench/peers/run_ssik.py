"""ssik: every solution of a pose in closed form; the one nearest to the start counts."""

# The package is not installed where types are checked, but in an environment of its own.
# pyright: basic, reportMissingImports=false

from __future__ import annotations

import numpy as np
from protocol import Array, CannotError, Problem, Solve, serve
from ssik import Manipulator


def prepare(problem: Problem) -> Solve:
    """Let ssik classify the arm; it supports arms of six and seven revolute joints."""
    problem.only("pose")
    try:
        arm = Manipulator.from_urdf(problem.urdf, base=problem.base, ee=problem.tip)
        arm.solve(problem.tip_at_zero)
    except (ImportError, NotImplementedError, RuntimeError, TypeError, ValueError) as error:
        raise CannotError(str(error).splitlines()[0]) from error

    def solve(T: Array, q0: Array) -> Array | None:
        found = arm.solve(T, max_solutions=1, q_seed=q0)
        return np.asarray(found[0].q) if found else None

    return solve


if __name__ == "__main__":
    serve("ssik", prepare)
