"""Follow a Cartesian path with the solver, without a jump between branches."""

from __future__ import annotations

import numpy as np

from ikservo.errors import CartesianPathError
from ikservo.ik import NOT_LIMITED, Options, Solver, Tolerance
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.motion.path import BlendedPath, OrientationInterpolation

__all__ = ["track_path"]

# So tight that the third difference of what is solved every half millimetre is no noise.
_TIGHT = Tolerance(1e-7, 1e-6)
_REACHED_M = 1e-6
# A millimetre, or a radian of the tool, that takes a joint this far runs past a singularity or to
# another branch.
_MAX_RAD_PER_M, _MAX_STEP_RAD = 60.0, 6.0
# How far inside its limits a line keeps a joint, as a share of the joint's range: the spline
# between the solved points may swing a little.
_INSIDE = 5e-4
_MAX_ITERATIONS, _SAME_PLANE_RAD = 8, 1e-10


def track_path(
    chain: Chain,
    start: Vector,
    path: BlendedPath,
    turning: OrientationInterpolation | None,
    count: int,
) -> Matrix:
    """Follow a path with the tip; its position is met exactly, its orientation as it can be.

    Args:
        chain: The arm.
        start: The joints where it begins (dof,).
        path: Where the tip goes, metres, base frame.
        turning: How the tool shall stand; None if any way will do.
        count: How many points, both ends included.

    Returns:
        The joints at even distances (count, dof).

    Raises:
        LineError: The path leaves what the arm reaches on this branch; says where.
    """
    solver = Solver(
        _with_tight_limits(chain, start),
        "position" if turning is None else "pose",
        options=Options(_TIGHT, position_first=True),
    )
    joints = [start]
    steepest_rad = _max_joint_step_rad(path, turning, count)
    for share in np.linspace(0.0, 1.0, count)[1:].tolist():
        q = _solve_point(solver, path, turning, share, joints[-1])
        _check_path_step(chain, solver, path, share, joints[-1], q, steepest_rad)
        joints.append(q)
    return np.array(joints)


def _solve_point(
    solver: Solver,
    path: BlendedPath,
    turning: OrientationInterpolation | None,
    share: float,
    before: Vector,
) -> Vector:
    T = np.eye(4)
    T[:3, 3] = path.at(share * path.length)[0]
    if turning is None:
        return solver.track(T, before)[0]
    q = before
    for _ in range(_MAX_ITERATIONS):
        T[:3, :3] = turning.at(share, q)
        turned_rad = turning.plane.angle_rad(q)
        q = solver.track(T, before)[0]
        if abs(turning.plane.angle_rad(q) - turned_rad) < _SAME_PLANE_RAD:
            break
    return q


def _check_path_step(
    chain: Chain,
    solver: Solver,
    path: BlendedPath,
    share: float,
    before: Vector,
    q: Vector,
    steepest_rad: float,
) -> None:
    """Refuse a step that does not reach, or that takes a joint too far."""
    result = solver.result
    steps = np.abs(q - before)
    if result.position_error_m <= _REACHED_M and steps.max() <= steepest_rad:
        return
    if result.position_error_m > _REACHED_M:
        why = [str(limit) for limit in result.binding] or [NOT_LIMITED]
    else:
        why = [f"{chain.names[int(steps.argmax())]} would have to jump (singularity)"]
    raise CartesianPathError(
        share * path.length,
        path.at(share * path.length)[0].tolist(),
        chain.forward(before)[:3, 3].tolist(),
        why,
    )


def _max_joint_step_rad(
    path: BlendedPath, turning: OrientationInterpolation | None, count: int
) -> float:
    turn_rad = 0.0 if turning is None else float(np.linalg.norm(turning.turn_rad))
    return (_MAX_RAD_PER_M * path.length + _MAX_STEP_RAD * turn_rad) / (count - 1) + 1e-6


def _with_tight_limits(chain: Chain, start: Vector) -> Chain:
    """Return the chain with limits a hair tighter, the start always inside."""
    room = np.where(np.isfinite(chain.upper_rad - chain.lower_rad), _INSIDE, 0.0)
    span = np.where(room > 0.0, chain.upper_rad - chain.lower_rad, 0.0)
    lower = np.minimum(chain.lower_rad + room * span, start)
    upper = np.maximum(chain.upper_rad - room * span, start)
    return chain.with_limits(lower, upper)
