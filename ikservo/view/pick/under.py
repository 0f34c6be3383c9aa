"""What is under the pointer: links, objects of the scene, and joints (lecture L17, L18)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Matrix, Vector
from ikservo.view.camera.camera import Camera
from ikservo.view.pick.pick import Hit, Picker
from ikservo.view.scene.dials import Dial, dials_of
from ikservo.view.scene.posing import link_poses

__all__ = ["Found", "Sight", "Under"]

_HUB_PX, _NEAR_PX = 10.0, 30.0
_SAME_RAD = 2e-3


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


class Found(NamedTuple):
    """Something under the pointer.

    Attributes:
        hit: Where.
        kind: ``link`` that q moves, ``fixed`` link, or ``object`` of the scene.
        q: Joints (dof,) of the arm that it belongs to; None for an object.
    """

    hit: Hit
    kind: Literal["link", "fixed", "object"]
    q: Vector | None


class Under:
    """Finds links, objects and joints by pixels.

    Args:
        chain: The arm.
        picker: Finds its links.
        objects: Finds the objects of the scene, in the base frame; None for none.
    """

    def __init__(self, chain: Chain, picker: Picker, objects: Picker | None = None) -> None:
        self._chain, self._picker, self._objects = chain, picker, objects
        self._dials = {dial.column: dial for dial in dials_of(chain, chain.middle())}

    def all(self, at: Vector, sight: Sight) -> tuple[Found, ...]:
        """Return all that is under the pointer, what a press grabs first, then what is behind.

        Links that move come first, those of the goal before those of the arm, which is painted
        below it; then objects, then links that stand still. Of each kind what is right under the
        pointer is before what is beside it, and the nearest first.
        """
        layers = [self._links(at, sight, q) for q in _apart(sight.arms)]
        moving = [found for layer in layers for found in layer if found.kind == "link"]
        fixed = [found for found in layers[-1] if found.kind == "fixed"]
        ordered = [*sorted(moving, key=_beside), *self._things(at, sight), *fixed]
        return tuple(ordered)

    def _links(self, at: Vector, sight: Sight, q: Vector) -> list[Found]:
        hits = self._picker.all_at(sight.camera, link_poses(self._chain, q, sight.beside), at)
        found = [Found(hit, "link" if self.columns(hit.link) else "fixed", q) for hit in hits]
        return sorted(found, key=_beside)

    def _things(self, at: Vector, sight: Sight) -> list[Found]:
        if self._objects is None:
            return []
        still = dict.fromkeys(self._objects.names, np.eye(4))
        hits = self._objects.all_at(sight.camera, still, at)
        return sorted((Found(hit, "object", None) for hit in hits), key=_beside)

    def dial(self, at: Vector, sight: Sight, found: Found | None) -> Dial | None:
        """Return the joint whose hub is under the pointer, else the one that moves the link."""
        poses, q = self.poses(sight), sight.arms[0]
        hubs_m = np.array([dial.hub(poses, q) for dial in self._dials.values()])
        away_px = np.hypot(*(sight.camera.project(hubs_m)[0] - at).T)
        nearest = int(np.argmin(away_px))
        if away_px[nearest] <= (_HUB_PX if found else _NEAR_PX):
            return list(self._dials.values())[nearest]
        return self._dials[self.columns(found.hit.link)[-1]] if found else None

    def poses(self, sight: Sight) -> dict[str, Matrix]:
        """Return T_world_link (4, 4) of every link of the arm that moves."""
        return link_poses(self._chain, sight.arms[0], sight.beside)

    def columns(self, link: str) -> list[int]:
        """Return the entries of q that move a link, base to tip."""
        return [step.column for step in self._chain.way(link) if step.scale]


def _beside(found: Found) -> bool:
    """Return whether it is beside the pointer: a stable sort leaves the rest by depth."""
    return found.hit.away_px > 0.0


def _apart(arms: Sequence[Vector]) -> list[Vector]:
    """Return arms without those that stand where one before them does."""
    kept = list[Vector]()
    for q in arms:
        if not any(float(np.abs(q - other).max()) < _SAME_RAD for other in kept):
            kept.append(q)
    return kept
