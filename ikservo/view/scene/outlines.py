"""The outlines of an arm's capsules on the screen: what a person sees of its body."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ikservo.kinematics.capsules import Capsule
from ikservo.kinematics.se3 import Matrix, Vector
from ikservo.view.camera.camera import Camera

__all__ = ["Outline", "Outlines"]

_CORNERS = 20
_ANGLES = np.arange(_CORNERS) * (math.tau / _CORNERS)
_ROUND = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])
_INSIDE = 0.9  # an eye that is in a ball sees it as if it were just outside


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """One link as it is seen.

    Attributes:
        depth_m: How far from the eye its middle is.
        rings: An outline for each of its capsules (capsules, k, 2), CSS pixels.
    """

    link: str
    depth_m: float
    rings: Matrix


class Outlines:
    """The capsules of an arm, laid out for drawing.

    Args:
        capsules: Any number for each link, in link coordinates.
    """

    def __init__(self, capsules: Sequence[Capsule]) -> None:
        ordered = sorted(capsules, key=lambda capsule: capsule.link)
        owners = [capsule.link for capsule in ordered]
        self.links = tuple(dict.fromkeys(owners))
        self._first = [owners.index(link) for link in self.links]
        self._counts = counts = np.diff([*self._first, len(owners)])
        self._spans = [slice(a, a + n) for a, n in zip(self._first, counts.tolist(), strict=True)]
        self._owner = np.array([self.links.index(link) for link in owners], dtype=np.intp)
        ends = [(capsule.start_m, capsule.end_m) for capsule in ordered]
        self._ends = np.array(ends, dtype=np.float64).reshape(-1, 2, 3)
        self._radii_m = np.array([capsule.radius_m for capsule in ordered])

    def seen(self, camera: Camera, poses: Mapping[str, Matrix]) -> list[Outline]:
        """Return the links where ``poses`` T_world_link (4, 4) put them, the farthest first."""
        if not self.links:
            return []
        ends = self._placed(poses)
        rings = _hulls(*_balls(camera, ends, self._radii_m[:, None]))
        sums = np.add.reduceat(camera.depth_of(ends).mean(axis=1), self._first)
        depths: list[float] = (sums / self._counts).tolist()
        found = [
            Outline(link, depth, rings[span])
            for link, depth, span in zip(self.links, depths, self._spans, strict=True)
        ]
        return sorted(found, key=lambda outline: -outline.depth_m)

    def _placed(self, poses: Mapping[str, Matrix]) -> Matrix:
        """Return both ends (capsules, 2, 3) in world coordinates."""
        T = np.array([poses[link] for link in self.links])[self._owner]
        placed: Matrix = self._ends @ T[:, :3, :3].transpose(0, 2, 1) + T[:, None, :3, 3]
        return placed


def _balls(camera: Camera, centres_m: Matrix, radii_m: Matrix) -> tuple[Matrix, Matrix]:
    """Return the outlines (n, k, 2) of the balls at the first and at the second ends (n, 2, 3).

    From an eye at distance d a ball of radius r shows the circle in which its tangents touch it:
    nearer by r²/d, and smaller by sqrt(1 - (r/d)²).
    """
    radii = np.broadcast_to(radii_m, centres_m.shape[:-1])[..., None]
    right, up = camera.right, camera.up
    if camera.perspective:
        away = centres_m - camera.eye_m
        d = np.sqrt(np.einsum("...i,...i->...", away, away))[..., None]
        radii = np.minimum(radii, _INSIDE * d)
        centres_m = centres_m - away * (radii / d) ** 2
        radii = radii * np.sqrt(1.0 - (radii / d) ** 2)
        right = _unit(np.cross(away, camera.up))
        up = _unit(np.cross(right, away))
    across = _ROUND[:, :1] * right[..., None, :] + _ROUND[:, 1:] * up[..., None, :]
    px, _ = camera.project(centres_m[..., None, :] + radii[..., None] * across)
    return px[:, 0], px[:, 1]


def _hulls(first: Matrix, second: Matrix) -> Matrix:
    """Return the outline (n, k, 2) around two rounds: in each direction the farther of both."""
    directions = _ROUND * (1.0, -1.0)
    farther = np.einsum("nki,ki->nk", second - first, directions) > 0.0
    return np.where(farther[..., None], second, first)


def _unit(v: Vector) -> Vector:
    length: Vector = np.sqrt(np.einsum("...i,...i->...", v, v))[..., None]
    return v / np.maximum(length, 1e-12)
