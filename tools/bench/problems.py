"""The problems of all solvers: the same arms, targets and starts, drawn from one seed."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import ikservo
from ikservo.kinematics.se3 import exp_so3, log_so3

__all__ = ["KINDS", "TOOL_AXIS", "Array", "problem_of", "rounds_of"]

Array = NDArray[np.float64]

KINDS = ("position", "direction", "pose")
TOOL_AXIS = (0.0, 0.0, 1.0)
# Tolerances requested of every solver; results are scored with ten times these.
_POSITION_M, _ANGLE_RAD = 1e-5, 1e-4
_NEAR_RAD = np.radians(5.0)
_LINE_POINTS = 1000
# A line leads from one reachable pose to another no farther than this in any joint.
_LINE_REACH_RAD = 0.4
_FULL_POSE_DOF = 6


def problem_of(model: ikservo.Model, kind: str) -> dict[str, Any]:
    """Return the fields of ``peers/protocol.py``'s ``Problem``, ready for JSON."""
    chain = model.chain
    T, J = chain.forward_and_jacobian(np.zeros(chain.dof))
    axes: Array = J[3:].T
    pivots: Array = T[:3, 3] + np.cross(axes, J[:3].T)
    return {
        "urdf": str(model.path.with_name("arm.urdf").resolve()),
        "base": chain.base,
        "tip": chain.tip,
        "path": _path(model),
        "joints": list(chain.names),
        "lower": chain.lower_rad.tolist(),
        "upper": chain.upper_rad.tolist(),
        "axes": axes.tolist(),
        "pivots": pivots.tolist(),
        "tip_at_zero": T.tolist(),
        "kind": kind,
        "tool_axis": list(TOOL_AXIS),
        "position_m": _POSITION_M,
        "angle_rad": _ANGLE_RAD,
    }


def rounds_of(
    model: ikservo.Model, kind: str, count: int, lines: int, seed: int
) -> dict[str, dict[str, Any]]:
    """Return targets (n, 4, 4) and starts by round: from home, from within 5°, along lines.

    Lines of directions and poses need six joints, because fewer cannot follow them.
    """
    chain, rng = model.chain, np.random.default_rng(seed)
    home = model.chain_pose("home")
    wanted = rng.uniform(chain.lower_rad, chain.upper_rad, (count, chain.dof))
    poses = [chain.forward(q).tolist() for q in wanted]
    near = chain.clip(wanted + rng.uniform(-_NEAR_RAD, _NEAR_RAD, wanted.shape))
    rounds = {
        "home": {"T": poses, "q0": [home.tolist()] * count},
        "near": {"T": poses, "q0": near.tolist()},
    }
    if lines and (kind == "position" or chain.dof >= _FULL_POSE_DOF):
        rounds["line"] = _lines(chain, lines, rng)
    return rounds


def _lines(chain: ikservo.Chain, count: int, rng: np.random.Generator) -> dict[str, Any]:
    """Return straight lines, one after another; only the first point of each has a start."""
    poses: list[Any] = []
    starts: list[Any] = []
    for _ in range(count):
        q = rng.uniform(chain.lower_rad, chain.upper_rad)
        end = chain.clip(q + rng.uniform(-_LINE_REACH_RAD, _LINE_REACH_RAD, chain.dof))
        poses += [T.tolist() for T in _straight(chain.forward(q), chain.forward(end))]
        starts += [q.tolist(), *[None] * (_LINE_POINTS - 1)]
    return {"T": poses, "q0": starts}


def _straight(A: Array, B: Array) -> list[Array]:
    """Return poses evenly between two, rotating about one axis."""
    turn = log_so3(B[:3, :3] @ A[:3, :3].T)
    poses: list[Array] = []
    for share in np.linspace(0.0, 1.0, _LINE_POINTS):
        T = np.eye(4)
        T[:3, :3] = exp_so3(share * turn) @ A[:3, :3]
        T[:3, 3] = A[:3, 3] + share * (B[:3, 3] - A[:3, 3])
        poses.append(T)
    return poses


def _path(model: ikservo.Model) -> list[str]:
    path = [model.chain.base]
    for joint in model.urdf.joints_to(model.chain.tip):
        path += [joint.name, joint.child]
    return path
