"""Joints along a path of the tool, each solved from the one before on its own branch."""

from __future__ import annotations

import numpy as np

from ikservo.errors import LineError
from ikservo.ik import BUILD, Options, Solver, Tolerance
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Matrix, Vector
from ikservo.motion.rounded import Rounded
from ikservo.motion.turning import Turning

__all__ = ["walk"]

# So tight that the third difference of what is solved every half millimetre is no noise.
_TIGHT = Tolerance(1e-7, 1e-6)
_REACHED_M = 1e-6
# A millimetre, or a radian of the tool, that takes a joint this far runs past a singularity or to
# another branch.
_STEEPEST_RAD_M, _STEEPEST_RAD = 60.0, 6.0
# How far inside its limits a line keeps a joint, as a share of the joint's range: the spline
# between the solved points may swing a little.
_INSIDE = 5e-4
_ROUNDS, _SAME_PLANE_RAD = 8, 1e-10


def walk(chain: Chain, start: Vector, path: Rounded, turning: Turning | None, count: int) -> Matrix:
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
        _inside(chain, start),
        "position" if turning is None else "pose",
        options=Options(_TIGHT, position_first=True),
    )
    joints = [start]
    steepest_rad = _steepest_rad(path, turning, count)
    for share in np.linspace(0.0, 1.0, count)[1:].tolist():
        q = _solved(solver, path, turning, share, joints[-1])
        _check(chain, solver, path, share, joints[-1], q, steepest_rad)
        joints.append(q)
    return np.array(joints)


def _solved(
    solver: Solver, path: Rounded, turning: Turning | None, share: float, before: Vector
) -> Vector:
    T = np.eye(4)
    T[:3, 3] = path.at(share * path.length)[0]
    if turning is None:
        return solver.track(T, before)[0]
    q = before
    for _ in range(_ROUNDS):
        T[:3, :3] = turning.at(share, q)
        turned_rad = turning.plane.angle_rad(q)
        q = solver.track(T, before)[0]
        if abs(turning.plane.angle_rad(q) - turned_rad) < _SAME_PLANE_RAD:
            break
    return q


def _check(
    chain: Chain,
    solver: Solver,
    path: Rounded,
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
        why = [str(limit) for limit in result.binding] or [BUILD]
    else:
        why = [f"{chain.names[int(steps.argmax())]} would have to jump (singularity)"]
    raise LineError(
        share * path.length,
        path.at(share * path.length)[0].tolist(),
        chain.forward(before)[:3, 3].tolist(),
        why,
    )


def _steepest_rad(path: Rounded, turning: Turning | None, count: int) -> float:
    turn_rad = 0.0 if turning is None else float(np.linalg.norm(turning.turn_rad))
    return (_STEEPEST_RAD_M * path.length + _STEEPEST_RAD * turn_rad) / (count - 1) + 1e-6


def _inside(chain: Chain, start: Vector) -> Chain:
    """Return the chain with limits a hair tighter, the start always inside."""
    room = np.where(np.isfinite(chain.upper_rad - chain.lower_rad), _INSIDE, 0.0)
    span = np.where(room > 0.0, chain.upper_rad - chain.lower_rad, 0.0)
    lower = np.minimum(chain.lower_rad + room * span, start)
    upper = np.maximum(chain.upper_rad - room * span, start)
    return chain.with_limits(lower, upper)
