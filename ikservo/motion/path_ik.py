"""Follow a Cartesian path with the solver, without a jump between branches."""

from __future__ import annotations

import numpy as np

from ikservo.errors import CartesianPathError
from ikservo.ik import NOT_LIMITED, Options, Result, Solver, Tolerance
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.motion.path import OrientationInterpolation, ToolPath

# With this tolerance, noise does not dominate third differences of points half a millimetre apart.
_TIGHT = Tolerance(1e-7, 1e-6)
_REACHED_M = 1e-6  # largest error of a solved point
# A joint that moves further passes a singularity or changes its branch.
_MAX_RAD_PER_M = 60.0  # 0.06 rad per millimetre of the path
_MAX_STEP_RAD = 6.0  # rad per radian of the tool
# Margin to the limits on a line, as a fraction of the joint's range, because the spline between the
# solved points may overshoot slightly.
_INSIDE = 5e-4
_MAX_ITERATIONS = 8  # to find a heading of the tool that fits the arm's plane
_SAME_PLANE_RAD = 1e-10  # a smaller rotation of this plane ends the iterations


def track_path(
    chain: Chain,
    start: Vector,
    path: ToolPath,
    orientation: OrientationInterpolation | None,
    count: int,
) -> Matrix:
    """Follow a path from joints (dof,): the position exactly, the orientation as well as possible.

    Returns:
        The joints at equal distances (count, dof).

    Raises:
        CartesianPathError: The path leaves the arm's reach on this branch; the error names the
            place.
    """
    span = chain.upper_rad - chain.lower_rad
    margin = np.where(np.isfinite(span), _INSIDE * span, 0.0)
    lower = np.minimum(chain.lower_rad + margin, start)
    upper = np.maximum(chain.upper_rad - margin, start)
    solver = Solver(
        chain.with_limits(lower, upper),
        "position" if orientation is None else "pose",
        options=Options(_TIGHT, position_first=True),
    )
    joints = [start]
    rotation_rad = 0.0 if orientation is None else float(np.linalg.norm(orientation.rotation_rad))
    largest_rad = _MAX_RAD_PER_M * path.length + _MAX_STEP_RAD * rotation_rad
    max_step_rad = largest_rad / (count - 1) + 1e-6
    for fraction in np.linspace(0.0, 1.0, count)[1:].tolist():
        before = joints[-1]
        q = _solve_point(solver, path, orientation, fraction, before)
        why = _find_obstruction(chain, solver.result, np.abs(q - before), max_step_rad)
        if why:
            target_m = path.at(fraction * path.length)[0].tolist()
            nearest_m = chain.forward(before)[:3, 3].tolist()
            raise CartesianPathError(
                fraction * path.length, target_m, nearest_m, why, shape=path.shape
            )
        joints.append(q)
    return np.array(joints)


def _find_obstruction(
    chain: Chain, result: Result, steps: Vector, max_step_rad: float
) -> list[str]:
    """Name the limits that block a step, or the joint that moves too far; empty if neither.

    The comparisons are written so that NaN is also refused.
    """
    if not result.position_error_m <= _REACHED_M:
        return [str(limit) for limit in result.binding] or [NOT_LIMITED]
    if not steps.max() <= max_step_rad:
        return [f"{chain.names[int(steps.argmax())]} would have to jump (singularity)"]
    return []


def _solve_point(
    solver: Solver,
    path: ToolPath,
    orientation: OrientationInterpolation | None,
    fraction: float,
    before: Vector,
) -> Vector:
    T = np.eye(4)
    T[:3, 3] = path.at(fraction * path.length)[0]
    if orientation is None:
        return solver.track(T, before)[0]
    q = before
    for _ in range(_MAX_ITERATIONS):
        T[:3, :3] = orientation.at(fraction, q)
        angle_rad = orientation.plane.angle_rad(q)
        q = solver.track(T, before)[0]
        if abs(orientation.plane.angle_rad(q) - angle_rad) < _SAME_PLANE_RAD:
            break
    return q
