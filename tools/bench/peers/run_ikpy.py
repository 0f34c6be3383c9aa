"""ikpy: its chain in NumPy under SciPy's ``least_squares``."""

# The package is not installed where types are checked, but in an environment of its own.
# pyright: basic, reportMissingImports=false

from __future__ import annotations

import warnings

import numpy as np
from ikpy.chain import Chain
from protocol import Array, CannotError, Problem, Solve, Tried, restarting, serve

_AXES = {(1, 0, 0): "X", (0, 1, 0): "Y", (0, 0, 1): "Z"}


def prepare(problem: Problem) -> Solve:
    """Build ikpy's chain along the path to the tip; fixed links are inactive."""
    warnings.simplefilter("ignore")
    joints = problem.path[1::2]
    active = [False] + [name in problem.joints for name in joints]
    chain = Chain.from_urdf_file(problem.urdf, base_elements=problem.path, active_links_mask=active)
    mode = {"position": None, "pose": "all"}.get(problem.kind, "direction")
    if mode == "direction":
        mode = _AXES.get(tuple(problem.tool_axis.astype(int)))
        if mode is None:
            raise CannotError("only directions of x, y or z")

    def once(T: Array, q0: Array) -> Tried:
        start = np.zeros(len(active))
        start[active] = q0
        q = chain.inverse_kinematics(
            T[:3, 3], _wanted(problem, T), mode, initial_position=start, tol=1e-10
        )
        return q[active], _arrived(problem, T, chain.forward_kinematics(q))

    return restarting(once, problem)


def _wanted(problem: Problem, T: Array) -> Array | None:
    if problem.kind == "position":
        return None
    return T[:3, :3] if problem.kind == "pose" else T[:3, :3] @ problem.tool_axis


def _arrived(problem: Problem, T: Array, here: Array) -> bool:
    met = np.linalg.norm(here[:3, 3] - T[:3, 3]) < problem.position_m
    off = here[:3, :3] - T[:3, :3]
    if problem.kind == "direction":
        off = off @ problem.tool_axis
    return bool(met and (problem.kind == "position" or np.linalg.norm(off) < problem.angle_rad))


if __name__ == "__main__":
    serve("ikpy", prepare)
