"""What of the arm is under the pointer: a link that moves, or a joint (lecture L17)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Matrix, Vector
from ikservo.view.camera.camera import Camera
from ikservo.view.pick.pick import Hit, Picker
from ikservo.view.scene.dials import Dial, dials_of
from ikservo.view.scene.posing import link_poses

__all__ = ["Sight", "Under"]

_HUB_PX, _NEAR_PX = 10.0, 30.0


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What the person has before them when an event happens.

    Attributes:
        camera: Where they look from.
        arms: Joints (dof,) of the arms that are drawn: the goal first, if there is one, then
            the measured arm. The first is the one that moves.
        plane_m: A point (3,) of the plane the view shows, where clicks on nothing go; that of
            the tip if None.
        beside: Positions of joints beside the way to the tip.
    """

    camera: Camera
    arms: tuple[Vector, ...]
    plane_m: Vector | None = None
    beside: Mapping[str, float] = field(default_factory=dict[str, float])


class Under:
    """Finds links and joints by pixels.

    Args:
        chain: The arm.
        picker: Finds its links.
    """

    def __init__(self, chain: Chain, picker: Picker) -> None:
        self._chain, self._picker = chain, picker
        self._dials = {dial.column: dial for dial in dials_of(chain, chain.middle())}

    def link(self, at: Vector, sight: Sight) -> tuple[Hit, Vector] | None:
        """Return what is under the pointer and the arm it belongs to; the base is as nothing."""
        for q in sight.arms:
            hit = self._picker.at(sight.camera, link_poses(self._chain, q, sight.beside), at)
            if hit is not None and self.columns(hit.link):
                return hit, q
        return None

    def dial(self, at: Vector, sight: Sight, hit: tuple[Hit, Vector] | None) -> Dial | None:
        """Return the joint whose hub is under the pointer, else the one that moves the link."""
        poses, q = self.poses(sight), sight.arms[0]
        hubs_m = np.array([dial.hub(poses, q) for dial in self._dials.values()])
        away_px = np.hypot(*(sight.camera.project(hubs_m)[0] - at).T)
        nearest = int(np.argmin(away_px))
        if away_px[nearest] <= (_HUB_PX if hit else _NEAR_PX):
            return list(self._dials.values())[nearest]
        return self._dials[self.columns(hit[0].link)[-1]] if hit else None

    def poses(self, sight: Sight) -> dict[str, Matrix]:
        """Return T_world_link (4, 4) of every link of the arm that moves."""
        return link_poses(self._chain, sight.arms[0], sight.beside)

    def columns(self, link: str) -> list[int]:
        """Return the entries of q that move a link, base to tip."""
        return [step.column for step in self._chain.way(link) if step.scale]
