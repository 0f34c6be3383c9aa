"""Panel of the things around the arm: draw, add, change, remove, save as a scene file."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ikservo.apps.page.dragging.drag import MovedThing
from ikservo.apps.page.drawing.scene_shapes import Fields, row_major
from ikservo.apps.page.messages import thing_messages as msg
from ikservo.apps.page.panels.follow_panel import FindArm
from ikservo.apps.page.picking.viewpoints import arm_extent
from ikservo.apps.page.server.downloads import Download, DownloadOffers
from ikservo.apps.page.server.message_age_and_rate import Client
from ikservo.apps.page.server.server import Frame
from ikservo.arm import Arm
from ikservo.arm.other_arm import OtherArm
from ikservo.errors import BadValueError
from ikservo.kinematics.arrays import Vector
from ikservo.kinematics.capsules import segment_distance
from ikservo.kinematics.packed import ROUNDING
from ikservo.kinematics.se3 import make_pose
from ikservo.model.arm_model import Obstacle
from ikservo.model.scene_file import describe_thing, scene_text

_DRAWN_M = 5.0  # larger things, such as half-spaces, are not drawn
_NEW_SIZE_M, _NEW_GAP_M = 0.06, 0.03  # size of a new thing, and its distance from arm and things
_NEW_AWAY = (0.6, 0.8, 0.45)  # places of a new thing, as fractions of the reach
_NEW_TURNS_DEG = (0.0, 25.0, -25.0, 50.0, -50.0, 75.0, -75.0)  # from the direction of the arm
_MOST = 100  # largest number of things, because each is sent and is checked on every path
_DECIMALS = 2  # decimals of joints, rad or m; smaller motions are not redrawn
_TITLES = {"box": "box", "cylinder": "can", "sphere": "ball"}

AddOtherArm = Callable[[str], None]
"""Function that makes another arm of the page, by its name, an obstacle to an arm."""


class ThingsPanel:
    """Editor of the things around an arm; offers them as a scene file for download."""

    def __init__(
        self,
        arm: Arm,
        downloads: DownloadOffers,
        find_arm: FindArm = lambda _: None,
        add_other_arm: AddOtherArm = lambda _: None,
    ) -> None:
        self._arm, self._downloads = arm, downloads
        self._find_arm, self._add_other_arm = find_arm, add_other_arm
        self._shown: object = None
        self._moved: MovedThing | None = None
        self._frame: Frame = {}

    def frames(self, client: Client, blocks: Sequence[Obstacle]) -> list[Frame]:
        """Return the things and blocks, if they have changed since they were sent to a client."""
        things, arms = self._arm.scene.things, self._arm.scene.arms
        joints: list[Vector | None] = []  # as last read; None for an arm that is closed
        for arm in arms:
            thread = self._find_arm(arm.name)
            is_open = thread is not None and thread.arm.context is arm.context
            joints.append(thread.snapshot.measured if thread is not None and is_open else None)
        drawn = [None if q is None else q.round(_DECIMALS).tolist() for q in joints]
        around = things, arms, drawn, blocks
        if around != self._shown:
            self._shown = around
            moved, links = self._moved, list[Obstacle]()
            for arm, q in zip(arms, joints, strict=True):  # a closed arm is drawn as it was left
                links += arm.left or () if q is None else arm.links_at(q)
            rows = [
                thing_fields(each, moved.shift_m if moved and moved.name == each.name else 0.0)
                for each in things
            ]
            rows += [  # the links of another arm are drawn separately
                {"name": arm.name, "thing": "arm", "sizes": _arm_sizes(arm), "drawn": False}
                for arm in arms
            ]
            self._frame = {
                "kind": "things",
                "things": rows,
                "links": [{**thing_fields(each), "shape": "cylinder"} for each in links]
                + [thing_fields(each) for each in blocks],
            }
        if client.sent.get("things") is self._frame:
            return []
        client.sent["things"] = self._frame
        return [self._frame]

    def handle(self, message: msg.ThingMessage, joints: Vector) -> None:
        """Add, change or remove a thing while nothing moves; put a new thing in front of the arm.

        Raises:
            UnknownNameError: There is no such thing.
            BadValueError: The new name is taken, the place is not valid, or there are too many
                things.
            InputError: No other arm of that name is open, or it is moving.
            FileFormatError: A size cannot be used; the message names it.
            RefusedError: A motion is running, or the arm was opened without collision checks.
        """
        scene = self._arm.scene
        match message:
            case msg.AddThing() if len(scene.names) >= _MOST:
                raise BadValueError("The number of things", len(scene.names), f"fewer than {_MOST}")
            case msg.AddThing():
                self._add_new(message.shape, joints)
            case msg.AddArm():
                self._add_other_arm(message.name)
            case msg.ChangeThing():
                given = message.model_dump(
                    exclude_none=True, exclude={"kind", "seq", "seen", "name"}
                )
                all_sizes = {each.name: _arm_sizes(each) for each in scene.arms}
                all_sizes |= {each.name: describe_thing(each)[1] for each in scene.things}
                sizes = all_sizes.get(message.name, {})
                for key in given.keys() & sizes.keys():
                    if isinstance(given[key], tuple):
                        pairs = zip(given[key], sizes[key], strict=True)
                        given[key] = [now if new is None else new for new, now in pairs]
                if "new_name" in given:
                    given["name"] = given.pop("new_name")
                scene.change(message.name, **given)
            case msg.RemoveThing():
                scene.remove(message.name)

    def show_moved(self, moved: MovedThing | None) -> None:
        """Draw a thing at the place to which it is dragged; None ends the drag."""
        if moved is not self._moved:
            self._moved, self._shown = moved, None

    def drop(self, moved: MovedThing) -> None:
        """Put a thing at the place where it was dropped.

        Raises:
            UnknownNameError: The thing was removed meanwhile.
            RefusedError: A motion is running.
        """
        self.show_moved(None)
        thing = next((each for each in self._arm.scene.things if each.name == moved.name), None)
        if thing is not None and moved.shift_m.any():
            self._arm.scene.change(moved.name, center_m=thing.row[9:12] + moved.shift_m)

    def offer(self) -> Frame:
        """Offer the things as a scene file; return its address."""
        scene, name = self._arm.scene, "scene.toml"
        text = scene_text(scene.things, [each.placed for each in scene.arms])
        url = self._downloads.offer(Download(name, lambda: [text], "application/toml"))
        return {"kind": "download", "url": url, "name": name}

    def _add_new(self, shape: str, joints: Vector) -> None:
        """Add a thing on the table, in front of the arm."""
        taken = {*self._arm.scene.names, *self._arm.scene.held}
        names = (f"the {_TITLES[shape]} {number}" for number in itertools.count(1))
        name = next(name for name in names if name not in taken)
        sizes: dict[str, Any] = {"radius_m": 0.5 * _NEW_SIZE_M}
        if shape == "box":
            sizes = {"size_m": (_NEW_SIZE_M,) * 3}
        elif shape == "cylinder":
            sizes["height_m"] = _NEW_SIZE_M
        center_m = tuple(self._free_place(joints).tolist())
        self._arm.scene.add(shape, name, center_m=center_m, **sizes)

    def _free_place(self, joints: Vector) -> Vector:
        """Find a place (3,) for a new thing in front of the arm: free, or with most clearance."""
        extent = arm_extent(self._arm.model)
        low_m = self._arm.model.floor_m or 0.0
        reach_m = float(np.abs(extent.box_m[:, :2] - extent.pivot_m[:2]).max())
        places = list[Vector]()
        for away, turn_deg in itertools.product(_NEW_AWAY, _NEW_TURNS_DEG):
            yaw_rad = extent.home_yaw_rad + math.radians(turn_deg)
            facing = np.array([math.cos(yaw_rad), math.sin(yaw_rad)])
            x_m, y_m = np.round(extent.pivot_m[:2] + away * reach_m * facing, 2)  # easy to read
            places.append(np.array([x_m, y_m, low_m + 0.5 * _NEW_SIZE_M]))
        gaps_m = [self._gap_m(place, joints) for place in places]
        free = (place for place, gap in zip(places, gaps_m, strict=True) if gap > _NEW_GAP_M)
        return next(free, places[int(np.argmax(gaps_m))])

    def _gap_m(self, place: Vector, joints: Vector) -> float:
        """Compute the distance from a new thing (3,) to the arm at joints (n,) and to things."""
        context, gaps_m = self._arm.context, [math.inf]
        if context.collision is not None:
            for each in context.collision.capsules_at(context.index.body_joints(joints)):
                away_m = float(segment_distance(place, place, each.start_m, each.end_m))
                gaps_m.append(away_m - each.radius_m)
        for thing in self._arm.scene.things:
            beside = np.maximum(np.subtract(thing.low_m, place), np.subtract(place, thing.high_m))
            gaps_m.append(float(np.linalg.norm(np.maximum(beside, 0.0))))
        return min(gaps_m) - 0.5 * math.sqrt(3.0) * _NEW_SIZE_M


def _arm_sizes(other: OtherArm) -> dict[str, Any]:
    placed = other.placed
    return {"at_m": placed.at_m, "rpy_deg": placed.rpy_deg}


def thing_fields(thing: Obstacle, shift_m: Vector | float = 0.0) -> Fields:
    """Return the drawing of a thing, shifted by (3,), and its editable fields."""
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
