"""SciPy's ``least_squares`` with bounds, over a product of exponentials written here."""

# The package is not installed where types are checked, but in an environment of its own.
# pyright: basic, reportMissingImports=false

from __future__ import annotations

import math

import numpy as np
from protocol import Array, Problem, Solve, Tried, restarting, serve
from scipy.optimize import least_squares


def prepare(problem: Problem) -> Solve:
    """Give SciPy the error and the Jacobian; its bounds are the joints' limits."""

    def error(q: Array, T: Array) -> Array:
        return _error(problem, T, _forward(problem, q)[0])

    def slope(q: Array, T: Array) -> Array:
        return _slope(problem, *_forward(problem, q))

    def once(T: Array, q0: Array) -> Tried:
        inside = np.clip(q0, problem.lower + 1e-9, problem.upper - 1e-9)
        answer = least_squares(
            error,
            inside,
            slope,
            (problem.lower, problem.upper),
            args=(T,),
            xtol=1e-10,
            ftol=1e-10,
            method="dogbox",
        )
        met = np.linalg.norm(answer.fun[:3]) < problem.position_m
        return answer.x, bool(met and np.linalg.norm(answer.fun[3:]) < problem.angle_rad)

    return restarting(once, problem)


def _forward(problem: Problem, q: Array) -> tuple[Array, Array, Array]:
    """Return the tip's pose (4, 4), and the axes and pivots (dof, 3) at the present joints."""
    T, axes, pivots = np.eye(4), [], []
    for axis, pivot, angle in zip(problem.axes, problem.pivots, q, strict=True):
        axes.append(T[:3, :3] @ axis)
        pivots.append(T[:3, :3] @ pivot + T[:3, 3])
        turn = np.eye(4)
        turn[:3, :3] = _turn(axis, angle)
        turn[:3, 3] = pivot - turn[:3, :3] @ pivot
        T = T @ turn
    return T @ problem.tip_at_zero, np.array(axes), np.array(pivots)


def _turn(axis: Array, angle: float) -> Array:
    x, y, z = axis
    W = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * W + (1.0 - math.cos(angle)) * (W @ W)


def _error(problem: Problem, T: Array, here: Array) -> Array:
    """Return the position error (3,) and the error of the compared columns of the rotation."""
    columns = _columns(problem)
    turn = (here[:3, :3] - T[:3, :3]) @ columns
    return np.concatenate([here[:3, 3] - T[:3, 3], turn.ravel()])


def _slope(problem: Problem, here: Array, axes: Array, pivots: Array) -> Array:
    linear = np.cross(axes, here[:3, 3] - pivots)
    columns = here[:3, :3] @ _columns(problem)
    swung = np.cross(axes[:, :, None], columns[None], axis=1)
    return np.vstack([linear.T, swung.reshape(len(axes), -1).T])


def _columns(problem: Problem) -> Array:
    """Return the tool's directions (3, k) that are compared."""
    all_of_them = {"position": np.zeros((3, 0)), "pose": np.eye(3)}
    return all_of_them.get(problem.kind, problem.tool_axis[:, None])


if __name__ == "__main__":
    serve("scipy", prepare)
