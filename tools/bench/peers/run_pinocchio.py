"""Pinocchio: its kinematics in C++; the damped least-squares loop with limits is written here."""

# The package is not installed where types are checked, but in an environment of its own.
# pyright: basic, reportMissingImports=false

from __future__ import annotations

import numpy as np
import pinocchio as pin
from protocol import Array, Problem, Solve, Tried, restarting, serve

_ITERATIONS = 30
# Damping in proportion to the error (Chan): careful far from the target, fast near it.
_DAMPING, _LEAST_DAMPING = 0.1, 1e-8


def prepare(problem: Problem) -> Solve:
    """Step and clip until the error is small; joints beside the path to the tip are fixed."""
    model = pin.buildModelFromUrdf(problem.urdf)
    data, frame = model.createData(), model.getFrameId(problem.tip, pin.FrameType.BODY)
    joints = [model.joints[model.getJointId(name)] for name in problem.joints]
    places, columns = [joint.idx_q for joint in joints], [joint.idx_v for joint in joints]
    whole = pin.neutral(model)

    def once(T: Array, q: Array) -> Tried:
        for _ in range(_ITERATIONS):
            whole[places] = q
            pin.computeJointJacobians(model, data, whole)
            here = pin.updateFramePlacement(model, data, frame)
            J = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)[:, columns]
            gap_m, turn_rad, J = _error(problem, T, here, J)
            if gap_m @ gap_m < problem.position_m**2 and turn_rad @ turn_rad < problem.angle_rad**2:
                return q, True
            error = np.concatenate([gap_m, turn_rad])
            damping = _DAMPING * (error @ error) + _LEAST_DAMPING
            step = J.T @ np.linalg.solve(J @ J.T + damping * np.eye(len(error)), error)
            q = np.clip(q + step, problem.lower, problem.upper)
        return q, False

    return restarting(once, problem)


def _error(problem: Problem, T: Array, here: pin.SE3, J: Array) -> tuple[Array, Array, Array]:
    gap_m, R = T[:3, 3] - here.translation, here.rotation
    if problem.kind == "position":
        return gap_m, np.zeros(0), J[:3]
    if problem.kind == "pose":
        return gap_m, pin.log3(T[:3, :3] @ R.T), J
    axis = R @ problem.tool_axis
    turn_rad: Array = np.cross(axis, T[:3, :3] @ problem.tool_axis).astype(float)
    across = J[3:] - np.outer(axis, axis @ J[3:])
    return gap_m, turn_rad, np.vstack([J[:3], across])


if __name__ == "__main__":
    serve("pin", prepare)
