"""What there is to see of an arm: how far it gets, and which plane is its own."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ikservo.ik.workspace import side_plane
from ikservo.ik.workspace.samples import joint_samples
from ikservo.kinematics import Chain, JointKind
from ikservo.kinematics.se3 import Matrix, Vector, pose
from ikservo.model import Model

__all__ = ["Stage", "home_of", "stage_of"]

_SAMPLES = 2000
_UPRIGHT, _PARALLEL = 0.99, 1e-3
_UNDER_THE_TABLE_M = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """The room that an arm moves in.

    Attributes:
        across: The axis (3,) that all joints of a flat arm turn about; None for other arms.
        box_m: Corners (2, 3) of where its links can be above the table, base frame.
        own_m: The same in the arm's own plane, as if that never turned: outwards, up, across.
        pivot_m: The point (3,) of the first axis that is level with the base.
        home: Joints (dof,) in which the arm usually works.
        home_yaw_rad: Where its own plane looks about z there.
        turns: How that plane turns with the first joint: 1, -1, or 0 where it does not.
    """

    across: Vector | None
    box_m: Matrix
    own_m: Matrix
    pivot_m: Vector
    home: Vector
    home_yaw_rad: float
    turns: int

    def yaw_rad(self, q: Vector) -> float:
        """Return where the arm's own vertical plane looks about z at joints (dof,)."""
        return self.home_yaw_rad + self.turns * float(q[0] - self.home[0])

    def plane(self, yaw_rad: float) -> Matrix:
        """Return the vertical plane (4, 4) through the first axis: u outwards, v up, w across."""
        return pose(self.pivot_m, _upright(yaw_rad))


def stage_of(model: Model) -> Stage:
    """Look at where an arm can be."""
    chain, home = model.chain, home_of(model)
    T_world_side = side_plane(chain, home)
    u = T_world_side[:3, 0]
    pivot = T_world_side[:3, 3] + u * float(_first_pivot(chain, home) @ u)
    yaw_rad, turns = math.atan2(float(u[1]), float(u[0])), _turns(chain, home)
    q = joint_samples(chain, _SAMPLES)
    links = np.stack([T[:, :3, 3] for T in chain.link_poses(q).values()], axis=1)
    if model.floor_m is not None:
        links[..., 2] = np.maximum(links[..., 2], model.floor_m - _UNDER_THE_TABLE_M)
    yaws_rad = yaw_rad + turns * (q[:, 0] - home[0])
    return Stage(
        across=_across(chain, home),
        box_m=_box(links),
        own_m=_box((links - pivot) @ _upright(yaws_rad)),
        pivot_m=pivot,
        home=home,
        home_yaw_rad=yaw_rad,
        turns=turns,
    )


def home_of(model: Model) -> Vector:
    """Return the joints (dof,) of the pose "home", or the middle of every range."""
    return model.chain_pose("home") if "home" in model.poses else model.chain.middle()


def _upright(yaw_rad: ArrayLike) -> Matrix:
    """Return the axes (…, 3, 3) of planes that look where yaws (…) say: outwards, up, across."""
    c, s, zero = np.cos(yaw_rad), np.sin(yaw_rad), np.zeros_like(yaw_rad)
    rows = [[c, zero, s], [s, zero, -c], [zero, zero + 1.0, zero]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def _first_pivot(chain: Chain, home: Vector) -> Vector:
    """Return the point (3,) of the first axis that is nearest to the tip."""
    T, J = chain.linearise(home)
    tip: Vector = T[:3, 3]
    return tip + np.cross(J[3:, 0], J[:3, 0])  # J = axis x (tip - pivot); 0 for a slide


def _turns(chain: Chain, home: Vector) -> int:
    """Return how the arm's own plane turns with the first joint; only about an upright axis."""
    upwards = float(chain.jacobian(home)[5, 0])
    if chain.kinds[0] is not JointKind.REVOLUTE or abs(upwards) < _UPRIGHT:
        return 0
    return round(upwards)


def _across(chain: Chain, home: Vector) -> Vector | None:
    """Return the axis (3,) that all joints turn about, if there is one."""
    axes = chain.jacobian(home)[3:].T
    apart = float(np.abs(np.cross(axes, axes[0])).max(initial=0.0))
    turning = all(kind is JointKind.REVOLUTE for kind in chain.kinds)
    return axes[0] if turning and apart < _PARALLEL else None


def _box(points_m: Matrix) -> Matrix:
    points = points_m.reshape(-1, 3)
    return np.array([points.min(axis=0), points.max(axis=0)])
