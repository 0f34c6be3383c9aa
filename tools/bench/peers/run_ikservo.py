"""Our own solver: prepared once and called in a loop, or given all targets at once."""

from __future__ import annotations

from protocol import Array, Batch, Problem, Solve, serve

import ikservo


def prepare(problem: Problem) -> Solve:
    """Prepare ``ikservo.Solver``; its result is scored, whether reached or not."""
    solver = _solver(problem)

    def solve(T: Array, q0: Array) -> Array | None:
        return solver(T, q0)[0]

    return solve


def prepare_line(problem: Problem) -> Solve:
    """Prepare a solver that follows paths without restarts."""
    solver = _solver(problem)

    def follow(T: Array, q0: Array) -> Array | None:
        return solver.track(T, q0)[0]

    return follow


def prepare_batch(problem: Problem) -> Batch:
    """Solve the batch on all cores."""
    chain = ikservo.load_model(problem.urdf, problem.tip).chain

    def batch(poses: Array, starts: Array) -> Array:
        return ikservo.solve_batch(
            chain, poses, starts, kind=problem.kind, tool_axis=problem.tool_axis
        ).q

    return batch


def _solver(problem: Problem) -> ikservo.Solver:
    chain = ikservo.load_model(problem.urdf, problem.tip).chain
    return ikservo.Solver(chain, problem.kind, tool_axis=problem.tool_axis)


if __name__ == "__main__":
    serve("ikservo", prepare, prepare_line=prepare_line, prepare_batch=prepare_batch)
