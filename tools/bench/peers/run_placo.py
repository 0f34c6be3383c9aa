"""placo: quadratic programs over Pinocchio, repeated until the tip arrives."""

# The package is not installed where types are checked, but in an environment of its own.
# pyright: basic, reportMissingImports=false

from __future__ import annotations

import numpy as np
import placo
from protocol import Array, Problem, Solve, Tried, restarting, serve

_ITERATIONS = 30


def prepare(problem: Problem) -> Solve:
    """Fix the base and everything beside the path to the tip; add a task for the target."""
    robot = placo.RobotWrapper(problem.urdf, placo.Flags.ignore_collisions)
    solver = placo.KinematicsSolver(robot)
    solver.mask_fbase(True)
    for name in robot.joint_names():
        if name not in problem.joints:
            solver.mask_dof(name)
    places = [robot.get_joint_offset(name) for name in problem.joints]
    set_target = _task(problem, solver)
    neutral = robot.neutral_state().q.copy()

    def once(T: Array, q0: Array) -> Tried:
        neutral[places] = q0
        robot.state.q = neutral
        robot.update_kinematics()
        set_target(T)
        for _ in range(_ITERATIONS):
            if _arrived(problem, T, robot.get_T_world_frame(problem.tip)):
                return robot.state.q[places].copy(), True
            solver.solve(True)
            robot.update_kinematics()
        return robot.state.q[places].copy(), False

    return restarting(once, problem)


def _task(problem: Problem, solver: placo.KinematicsSolver):  # noqa: ANN202
    if problem.kind == "pose":
        frame = solver.add_frame_task(problem.tip, np.eye(4))
        frame.configure(problem.tip, "soft", 1.0, 1.0)
        return lambda T: setattr(frame, "T_world_frame", T)
    position = solver.add_position_task(problem.tip, np.zeros(3))
    position.configure("position", "soft", 1.0)
    if problem.kind == "position":
        return lambda T: setattr(position, "target_world", T[:3, 3])
    axis = solver.add_axisalign_task(problem.tip, problem.tool_axis, np.array([0.0, 0.0, 1.0]))
    axis.configure("axis", "soft", 1.0)

    def set_both(T: Array) -> None:
        position.target_world = T[:3, 3]
        axis.targetAxis_world = T[:3, :3] @ problem.tool_axis

    return set_both


def _arrived(problem: Problem, T: Array, here: Array) -> bool:
    if np.linalg.norm(here[:3, 3] - T[:3, 3]) > problem.position_m:
        return False
    off = here[:3, :3] - T[:3, :3]
    if problem.kind == "direction":
        off = off @ problem.tool_axis
    return bool(problem.kind == "position" or np.linalg.norm(off) < problem.angle_rad)


if __name__ == "__main__":
    serve("placo", prepare)
