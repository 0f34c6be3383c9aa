"""The tool kept as it stands, in the plane that the arm's first joint turns, as the arm can."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ikservo.ik import Options, Result, Solver, Target
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Vector, log_so3, pose
from ikservo.motion.plane import ArmPlane

__all__ = ["REACHED_M", "ROUNDS", "STANDS_RAD", "Standing", "kept"]

ROUNDS = 6
"""So often a heading that the tool is to have is found anew from the answer."""

STANDS_RAD = 3e-4
REACHED_M = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class Standing:
    """Joints for a point, and how the tool stands there.

    Attributes:
        solution: What the solver answered; ``reached`` and the error speak of the position.
        left_rad: How far the tool is from how it should stand.
    """

    solution: Result
    left_rad: float


def kept(chain: Chain, target: Target, here: Vector, plain: Result) -> Standing:
    """Return the joints near the plain answer at which the tool stands most as it does now."""
    plane = ArmPlane(chain)
    first = plane.rotation(here).T @ chain.forward(here)[:3, :3]
    solver = Solver(chain, "pose", options=Options(position_first=True))
    q, wanted = plain.q, first
    for _ in range(ROUNDS):
        before, wanted = plane.angle_rad(q), plane.rotation(q) @ first
        found, _ = solver.track(pose(target.position, wanted), q)
        if solver.result.position_error_m > REACHED_M:
            break
        q = found
        if abs(plane.angle_rad(q) - before) < STANDS_RAD:
            break
    left = log_so3(wanted @ chain.forward(q)[:3, :3].T)
    return Standing(_at(chain, target, plain, q), float(np.linalg.norm(left)))


def _at(chain: Chain, target: Target, plain: Result, q: Vector) -> Result:
    nearest_m = chain.forward(q)[:3, 3]
    gap_m = float(np.linalg.norm(nearest_m - target.position))
    return replace(plain, q=q, nearest_m=nearest_m, position_error_m=gap_m)
