"""EAIK: all solutions of a pose in closed form; the nearest one inside the limits counts."""

# The package is not installed where types are checked, but in an environment of its own.
# pyright: basic, reportMissingImports=false

from __future__ import annotations

import os

import numpy as np
from eaik.IK_HP import HPRobot
from protocol import Array, CannotError, Problem, Solve, serve


def prepare(problem: Problem) -> Solve:
    """Give EAIK the axes and their distances, which it otherwise reads from a URDF."""
    robot = _robot(problem)
    unturn = problem.tip_at_zero[:3, :3].T

    def solve(T: Array, q0: Array) -> Array | None:
        wanted = T.copy()
        wanted[:3, :3] = T[:3, :3] @ unturn
        return _nearest(problem, robot.IK(wanted), q0)

    return solve


def prepare_batch(problem: Problem):  # noqa: ANN201
    """Solve the batch with EAIK's own threads."""
    robot = _robot(problem)
    unturn = problem.tip_at_zero[:3, :3].T

    def batch(poses: Array, starts: Array) -> Array:
        wanted = poses.copy()
        wanted[:, :3, :3] = poses[:, :3, :3] @ unturn
        answers = robot.IK_batched(wanted, os.cpu_count() or 1)
        found = (_nearest(problem, a, q0) for a, q0 in zip(answers, starts, strict=True))
        return np.array([np.full(len(starts[0]), np.nan) if q is None else q for q in found])

    return batch


def _robot(problem: Problem) -> HPRobot:
    problem.only("pose")
    points = np.vstack([problem.pivots, problem.tip_at_zero[:3, 3]])
    robot = HPRobot(problem.axes, np.vstack([points[:1], np.diff(points, axis=0)]))
    if not robot.hasKnownDecomposition():
        raise CannotError("has no decomposition of this arm")
    return robot


def _nearest(problem: Problem, answer, q0: Array) -> Array | None:  # noqa: ANN001
    """Return the solution inside the limits nearest the start, an exact one if there is any."""
    if not len(answer.Q):
        return None
    Q = (np.asarray(answer.Q) + np.pi) % (2 * np.pi) - np.pi
    inside = np.all((problem.lower <= Q) & (problem.upper >= Q), axis=1)
    exact = inside & ~np.asarray(answer.is_LS, dtype=bool)
    Q = Q[exact if exact.any() else inside]
    return Q[np.abs(Q - q0).max(axis=1).argmin()] if len(Q) else None


if __name__ == "__main__":
    serve("EAIK", prepare, prepare_batch=prepare_batch)
