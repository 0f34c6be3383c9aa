"""The things around the arm on the page: drawn, added, changed, removed, saved as a scene file."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from ikservo.arm import Arm
from ikservo.errors import BadValueError
from ikservo.kinematics.arrays import Vector
from ikservo.kinematics.packed import ROUNDING
from ikservo.kinematics.se3 import make_pose
from ikservo.model.model import Obstacle
from ikservo.model.scene import describe_thing, scene_text
from ikservo.view import thing_messages as msg
from ikservo.view.connection import Client
from ikservo.view.downloads import Download, DownloadOffers
from ikservo.view.drag import MovedThing
from ikservo.view.scene_shapes import Fields, row_major
from ikservo.view.server import Frame

__all__ = ["ThingsPanel"]

_DRAWN_M = 5.0  # what is larger, such as a half-space, is not drawn
_NEW_SIZE_M, _NEW_AWAY_M = 0.06, 0.1  # of a new thing, and of its place from the base
_MOST = 100  # that a page adds to: each is checked on every path, and sent
_TITLES = {"box": "box", "cylinder": "can", "sphere": "ball"}


class ThingsPanel:
    """Shows and changes what stands around an arm.

    Args:
        arm: The arm.
        downloads: Where the scene file is offered.
    """

    def __init__(self, arm: Arm, downloads: DownloadOffers) -> None:
        self._arm, self._downloads = arm, downloads
        self._shown: tuple[Obstacle, ...] | None = None
        self._moved: MovedThing | None = None
        self._frame: Frame = {}

    def frames(self, client: Client) -> list[Frame]:
        """Return the things, where they have changed since they were sent to a client."""
        things = self._arm.scene.things
        if things != self._shown:
            self._shown = things
            self._frame = {"kind": "things", "things": [self._fields(each) for each in things]}
        if client.sent.get("things") is self._frame:
            return []
        client.sent["things"] = self._frame
        return [self._frame]

    def handle(self, message: msg.ThingMessage) -> None:
        """Add, change or remove a thing, while nothing moves.

        Raises:
            UnknownNameError: There is no such thing.
            BadValueError: Its new name is taken, or there are too many.
            FileFormatError: A size cannot be used; names it.
            RefusedError: A motion is running, or the arm was opened without collision checks.
        """
        scene = self._arm.scene
        match message:
            case msg.AddThing() if len(scene.names) >= _MOST:
                raise BadValueError("The number of things", len(scene.names), f"below {_MOST}")
            case msg.AddThing():
                scene.add(message.shape, self._new_name(message.shape), **self._new(message.shape))
            case msg.ChangeThing():
                given = message.model_dump(
                    exclude_none=True, exclude={"kind", "seq", "seen", "name"}
                )
                if "new_name" in given:
                    given["name"] = given.pop("new_name")
                scene.change(message.name, **given)
            case msg.RemoveThing():
                scene.remove(message.name)

    def show_moved(self, moved: MovedThing | None) -> None:
        """Draw a thing where it is dragged to; None once nothing is dragged."""
        if moved is not self._moved:
            self._moved, self._shown = moved, None

    def drop(self, moved: MovedThing) -> None:
        """Put a thing where it was dragged to.

        Raises:
            UnknownNameError: It was removed meanwhile.
            RefusedError: A motion is running.
        """
        self.show_moved(None)
        thing = next((each for each in self._arm.scene.things if each.name == moved.name), None)
        if thing is not None and moved.shift_m.any():
            self._arm.scene.change(moved.name, centre_m=thing.row[9:12] + moved.shift_m)

    def offer(self) -> Frame:
        """Offer the things as a scene file; return where."""
        text, name = scene_text(self._arm.scene.things), "scene.toml"
        url = self._downloads.offer(Download(name, lambda: [text], "application/toml"))
        return {"kind": "download", "url": url, "name": name}

    def _fields(self, thing: Obstacle) -> Fields:
        moved = self._moved
        return thing_fields(thing, moved.shift_m if moved and moved.name == thing.name else 0.0)

    def _new_name(self, shape: str) -> str:
        taken = {*self._arm.scene.names, *self._arm.scene.held}
        names = (f"the {_TITLES[shape]} {number}" for number in itertools.count(1))
        return next(name for name in names if name not in taken)

    def _new(self, shape: str) -> dict[str, Any]:
        """Return place and size of a new thing: on the table, behind the base."""
        half_m = 0.5 * _NEW_SIZE_M
        low_m = self._arm.model.floor_m or 0.0
        place: dict[str, Any] = {"centre_m": (-_NEW_AWAY_M - half_m, 0.0, low_m + half_m)}
        if shape == "box":
            return {**place, "size_m": (_NEW_SIZE_M,) * 3}
        if shape == "cylinder":
            return {**place, "radius_m": half_m, "height_m": _NEW_SIZE_M}
        return {**place, "radius_m": half_m}


def thing_fields(thing: Obstacle, shift_m: Vector | float = 0.0) -> Fields:
    """Return how a thing is drawn, shifted (3,), and what a person may change of it."""
    row = thing.row
    kind, sizes = describe_thing(thing)
    grown = row[12:15] + row[ROUNDING]
    return {
        "name": thing.name,
        "shape": "box" if kind == "half_space" else kind,
        "pose": row_major(make_pose(row[9:12] + shift_m, row[:9].reshape(3, 3))),
        "half": grown.tolist(),
        "drawn": bool(np.max(2.0 * grown) < _DRAWN_M),
        "thing": kind,
        "sizes": sizes,
    }
