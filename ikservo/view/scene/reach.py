"""The region that the tip can reach in the plane a person looks at.

Finding it takes a tenth of a second to a second (``ikservo.ik.workspace``), so it is found once
for each ``key`` and kept::

    plane = shown_plane(stage, view, q)           # None: this view shows no region
    reach = kept.get(plane.key) or find_reach(chain, plane)
    shown = reach.moved_to(plane)                 # the arm's own plane turns with the arm
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ikservo.ik.workspace import workspace
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Matrix, Vector, pose
from ikservo.view.camera.camera import Camera
from ikservo.view.camera.stage import Stage
from ikservo.view.camera.views import ViewName
from ikservo.view.scene.items import Item, polygon

__all__ = ["Reach", "ShownPlane", "draw_reach", "find_reach", "shown_plane"]

_CELLS, _SAMPLES = 110, 2**14
_WINDOW, _EVERY = range(-2, 3), 2
_ROUNDED_M = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class ShownPlane:
    """The plane that a view shows.

    Attributes:
        key: Equal for planes in which the same region is reached.
        T_world_plane: Where it is (4, 4); what is shown is at w = 0.
        cell_m: How fine the region is worth finding.
    """

    key: tuple[str, float]
    T_world_plane: Matrix
    cell_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Reach:
    """The outlines of a region in a plane.

    Attributes:
        rings: Closed outlines (k, 2) [m] along u and v; holes run clockwise.
        T_world_plane: Where the plane is (4, 4).
    """

    rings: tuple[Matrix, ...]
    T_world_plane: Matrix

    @property
    def fingerprint(self) -> tuple[object, ...]:
        """Return what differs where another region, or another place of it, is shown."""
        return id(self.rings), self.T_world_plane.tobytes()

    def moved_to(self, plane: ShownPlane) -> Reach:
        """Return the same region where the plane is now."""
        return replace(self, T_world_plane=plane.T_world_plane)


def shown_plane(stage: Stage, name: ViewName, q: Vector, tip_m: Vector) -> ShownPlane | None:
    """Return the plane a view shows while the tip is at (3,); None for a view of no plane.

    From above and from the front it is the plane that the tip is in, to a centimetre.
    """
    if name == "orbit":
        return None
    if name == "side":
        return _plane(stage, (name, 0.0), stage.plane(stage.yaw_rad(q)))
    if name == "front":
        T = stage.plane(stage.home_yaw_rad)
        away = _rounded(float((tip_m - stage.pivot_m) @ T[:3, 0]))
        R = np.column_stack([-T[:3, 2], T[:3, 1], T[:3, 0]])
        return _plane(stage, (name, away), pose(T[:3, 3] + away * T[:3, 0], R))
    if stage.across is not None and abs(stage.across[2]) < 0.5:
        return _plane(stage, (name, 0.0), stage.plane(stage.home_yaw_rad))
    height = float(tip_m[2]) if stage.across is not None else _rounded(float(tip_m[2]))
    return _plane(stage, (name, round(height, 6)), pose((0.0, 0.0, height)))


def find_reach(chain: Chain, plane: ShownPlane) -> Reach:
    """Find what the tip can reach in a plane, inside the chain's limits."""
    region = workspace(chain, plane.T_world_plane, plane.cell_m, _SAMPLES)
    rings = tuple(_smooth(ring, plane.cell_m) for ring in region.outline())
    return Reach(rings, plane.T_world_plane)


def draw_reach(reach: Reach, camera: Camera) -> Item:
    """Return the region as a shape with holes."""
    T = reach.T_world_plane
    rings = [ring @ T[:3, :2].T + T[:3, 3] for ring in reach.rings]
    return polygon("reach", [camera.project(ring)[0] for ring in rings])


def _smooth(ring: Matrix, cell_m: float) -> Matrix:
    """Walk along a ring from cell to cell and take means: nobody shall see the cells."""
    ends = np.vstack([ring, ring[:1]])
    along = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(ends, axis=0)).sum(axis=1))])
    at = (np.arange(round(along[-1] / cell_m)) + 0.5) * cell_m  # sides run along u or v
    middles = np.column_stack([np.interp(at, along, ends[:, k]) for k in (0, 1)])
    mean: Matrix = np.mean([np.roll(middles, k, axis=0) for k in _WINDOW], axis=0)
    return mean[::_EVERY]


def _plane(stage: Stage, key: tuple[str, float], T_world_plane: Matrix) -> ShownPlane:
    size_m = float((stage.box_m[1] - stage.box_m[0]).max())
    return ShownPlane(key, T_world_plane, size_m / _CELLS)


def _rounded(metres: float) -> float:
    return round(metres / _ROUNDED_M) * _ROUNDED_M
