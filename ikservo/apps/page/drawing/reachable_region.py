"""The reachable region in the plane of a view, computed in the background and cached.

Computing it takes a tenth of a second to a second (``ikservo.ik.workspace``), so it is computed
once per ``key`` and cached::

    plane = slice_plane(extent, view, q, find_tip_m)    # None: this view shows no region
    region = cached.get(plane.key) or compute_region(chain, plane)
    shown = region.move_to_plane(plane)            # the arm's own plane rotates with the arm
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from ikservo.apps.page.picking.viewpoints import ArmExtent, ViewName
from ikservo.ik.workspace import workspace
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.se3 import make_pose

_CELLS, _SAMPLES = 110, 2**14
_WINDOW, _SAMPLING_STEP = range(-2, 3), 2
_ROUNDED_M, _RING_DIGITS = 0.01, 4

Ring = list[list[float]]


@dataclass(frozen=True, slots=True, eq=False)
class SlicePlane:
    """The plane that a view shows.

    Attributes:
        key: Key that is equal for planes with the same reachable region.
        T_world_plane: Pose of the plane (4, 4); the region is at w = 0.
        cell_m: Cell size for computing the region.
    """

    key: tuple[str, float]
    T_world_plane: Matrix
    cell_m: float


@dataclass(frozen=True, slots=True, eq=False)
class ReachableRegion:
    """The outlines of a region in a plane.

    Attributes:
        rings: Closed outlines (k, 2) [m] along u and v as they are sent to a page, rounded to 0.1
            mm; holes run clockwise.
        T_world_plane: Pose of the plane (4, 4).
    """

    rings: tuple[Ring, ...]
    T_world_plane: Matrix

    @property
    def fingerprint(self) -> tuple[object, ...]:
        """Key that changes with the region and its pose."""
        return id(self.rings), self.T_world_plane.tobytes()

    def move_to_plane(self, plane: SlicePlane) -> ReachableRegion:
        """Move the region to the pose of a plane."""
        return replace(self, T_world_plane=plane.T_world_plane)


def slice_plane(
    extent: ArmExtent, name: ViewName, q: Vector, find_tip_m: Callable[[], Vector]
) -> SlicePlane | None:
    """Compute the plane of a view at joints (dof,); None for a view without a plane.

    In the views from above and from the front it contains the tip, rounded to a centimetre.
    """
    if name == "orbit":
        return None
    if name == "side":
        return _make_plane(extent, (name, 0.0), extent.plane(extent.yaw_rad(q)))
    tip_m = find_tip_m()
    if name == "front":
        T = extent.plane(extent.home_yaw_rad)
        offset_m = _round_metres(float((tip_m - extent.pivot_m) @ T[:3, 0]))
        R = np.column_stack([-T[:3, 2], T[:3, 1], T[:3, 0]])
        return _make_plane(extent, (name, offset_m), make_pose(T[:3, 3] + offset_m * T[:3, 0], R))
    if extent.across is not None and abs(extent.across[2]) < 0.5:
        return _make_plane(extent, (name, 0.0), extent.plane(extent.home_yaw_rad))
    height = float(tip_m[2]) if extent.across is not None else _round_metres(float(tip_m[2]))
    return _make_plane(extent, (name, round(height, 6)), make_pose((0.0, 0.0, height)))


def compute_region(chain: Chain, plane: SlicePlane) -> ReachableRegion:
    """Compute the region of a plane that the tip can reach inside the chain's limits."""
    region = workspace(chain, plane.T_world_plane, plane.cell_m, _SAMPLES)
    rings = tuple(_smooth_ring(ring, plane.cell_m) for ring in region.outline())
    return ReachableRegion(rings, plane.T_world_plane)


def _smooth_ring(ring: Matrix, cell_m: float) -> Ring:
    """Resample a ring at one point per cell and smooth it, so that no cells are visible."""
    closed = np.vstack([ring, ring[:1]])
    length_m = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(closed, axis=0)).sum(axis=1))])
    at = (np.arange(round(length_m[-1] / cell_m)) + 0.5) * cell_m  # sides run along u or v
    centres = np.column_stack([np.interp(at, length_m, closed[:, k]) for k in (0, 1)])
    mean: Matrix = np.mean([np.roll(centres, k, axis=0) for k in _WINDOW], axis=0)
    rounded: Ring = np.round(mean[::_SAMPLING_STEP], _RING_DIGITS).tolist()
    return rounded


def _make_plane(extent: ArmExtent, key: tuple[str, float], T_world_plane: Matrix) -> SlicePlane:
    size_m = float((extent.box_m[1] - extent.box_m[0]).max())
    return SlicePlane(key, T_world_plane, size_m / _CELLS)


def _round_metres(metres: float) -> float:
    return round(metres / _ROUNDED_M) * _ROUNDED_M


_MAX_CACHED = 64


class ReachableRegionCache:
    """Computation of one region at a time in the background; callers poll ``get``."""

    def __init__(self, chain: Chain) -> None:
        self._chain = chain
        self._known: dict[tuple[str, float], ReachableRegion] = {}
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="ikservo reach")
        self._busy: tuple[tuple[str, float], Future[ReachableRegion]] | None = None

    def get(self, plane: SlicePlane, *, idle: bool = True) -> ReachableRegion | None:
        """Return the region in a plane; if not cached, return None and, if idle, compute it."""
        if self._busy is not None and self._busy[1].done():
            key, future = self._busy
            self._busy = None
            if len(self._known) >= _MAX_CACHED:
                self._known.pop(next(iter(self._known)))
            self._known[key] = future.result()
        cached = self._known.get(plane.key)
        if cached is None and self._busy is None and idle:
            self._busy = (plane.key, self._worker.submit(compute_region, self._chain, plane))
        return None if cached is None else cached.move_to_plane(plane)

    def close(self) -> None:
        """Cancel the running computation."""
        self._worker.shutdown(wait=False, cancel_futures=True)
