"""Dragging: conversion of pointer, wheel and keys to targets for the tip, a link or a joint.

If links, objects and the free plane overlap under the pointer, a click without motion, or a key
press, selects the next of them. Once the pointer has moved, or other things are under it, the first
is selected again. None stands for the free plane: the tip moves to the pointer.

A state machine without clock, page or servo; every event returns a command or None::

    drag = Drag(chain, picker)
    command = drag.press(px, context, shift=False, pointer=0)    # DragTarget or JointTarget
    command = drag.move(px, pointer=0)
    drag.release(pointer=0)
    command = drag.cancel()                                      # HoldCommand
    command = drag.wheel(px, notches, context, fine=False)       # JointTarget
    command = drag.on_key("ArrowUp", context, fine=False)        # DragTarget of the tip
    link = drag.hover(px, context)
    options, index = drag.candidates_under(px, context)          # overlapping things there
    drag.select_next(px, context)                                # a press grabs the next one

Touches and pens are pointers. A second pointer is ignored during a drag.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ikservo.apps.page.dragging.drag_commands import (
    DragCommand,
    DragTarget,
    HoldCommand,
    JointTarget,
)
from ikservo.apps.page.picking.lens_camera import PictureSurface
from ikservo.apps.page.picking.picking import HitTester, PickCandidate, Picker, PointerContext
from ikservo.apps.page.picking.projection import Camera
from ikservo.errors import InputError
from ikservo.ik import Target
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Vector

# Cosine of axis and line of sight below which the joint's circle is seen edge-on.
_MIN_FACING_COSINE = 0.3
_HUB_PX = 5.0
_MIN_LEVER_PX = 20.0
_LEVERLESS_RAD_PX = math.radians(0.5)
_SMALL = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class JointDrag:
    """A drag that moves one joint.

    Attributes:
        column: The index of the joint in q.
        camera: The camera when the drag started.
        pivot_m: A point (3,) of the axis.
        axis: The axis (3,), a unit vector.
        px: Last position of the pointer (2,), pixels.
        position: The joint position at the pointer, rad or m; may exceed the limits, so that the
            joint follows again once the pointer is back inside the range.
        lever_px: Velocity of the grabbed point on the screen (2,), pixels per rad or m; None if
            the pointer moves around the pivot instead.
    """

    column: int
    camera: Camera
    pivot_m: Vector
    axis: Vector
    px: Vector
    position: float
    lever_px: Vector | None

    def move_pointer(self, px: Vector) -> JointDrag:
        """Return the drag after the pointer has moved to a pixel (2,)."""
        if self.lever_px is not None:
            change = float((px - self.px) @ self.lever_px) / float(self.lever_px @ self.lever_px)
        else:
            old, new = self._pointer_angle(self.px), self._pointer_angle(px)
            change = 0.0 if old is None or new is None else math.remainder(new - old, math.tau)
        return replace(self, px=px, position=self.position + change)

    def _pointer_angle(self, px: Vector) -> float | None:
        """Compute the pointer's angle about the axis; None at the pivot, where it is undefined."""
        pivot_px, _ = self.camera.project(self.pivot_m)
        hit_m = self.camera.ray(px).intersect_plane(self.pivot_m, self.axis)
        if hit_m is None or float(np.hypot(*(px - pivot_px))) < _HUB_PX:
            return None
        reference = self.camera.right - self.axis * float(self.axis @ self.camera.right)
        if float(reference @ reference) < 0.1:
            reference = self.camera.up - self.axis * float(self.axis @ self.camera.up)
        lever_m = hit_m - self.pivot_m
        return math.atan2(
            float(np.cross(self.axis, reference) @ lever_m), float(reference @ lever_m)
        )


def start_joint_drag(
    column: int,
    camera: Camera,
    line: tuple[Vector, Vector],
    px: Vector,
    point_m: Vector,
    position: float,
    *,
    slides: bool,
) -> JointDrag:
    """Start a drag of the joint at ``column`` of q by a point (3,).

    ``line`` is a point (3,) of the joint's axis and the axis direction (3,), ``px`` is the
    pointer's pixel (2,), and ``position`` is the joint position, rad or m.
    """
    pivot, axis = line
    line_of_sight = camera.ray(camera.project(pivot)[0]).direction
    lever_px = None
    if slides or abs(float(line_of_sight @ axis)) < _MIN_FACING_COSINE:
        # Screen velocity (2,) of a point with a velocity (3,); upwards if it is almost zero.
        velocity = axis if slides else np.cross(axis, point_m - pivot)
        ends, _ = camera.project(point_m + np.array([[-_SMALL], [_SMALL]]) * velocity)
        lever: Vector = (ends[1] - ends[0]) / (2.0 * _SMALL)
        upwards = np.array([0.0, -1.0 / _LEVERLESS_RAD_PX])
        lever_px = lever if float(lever @ lever) > _MIN_LEVER_PX**2 else upwards
    return JointDrag(column, camera, pivot, axis, px, position, lever_px)


AT_REST_PX = 4.0
"""Motion of the pointer, in pixels, below which it counts as at rest."""

Names = tuple[tuple[str, str] | None, ...]


class CandidateSelection:
    """Selection among the overlapping things under a resting pointer."""

    def __init__(self, hit_tester: HitTester) -> None:
        self._hit_tester = hit_tester
        self._at: Vector | None = None
        self._names: Names = ()
        self._index = 0

    def candidates_at(
        self, at: Vector, context: PointerContext
    ) -> tuple[PickCandidate | None, ...]:
        """List what a press can grab: links and objects, the free plane (None), fixed links."""
        found = self._hit_tester.candidates_at(at, context)
        fixed = tuple(each for each in found if each.kind == "fixed")
        return (*found[: len(found) - len(fixed)], None, *fixed)

    def selected_index(self, at: Vector, options: tuple[PickCandidate | None, ...]) -> int:
        """Return the index of the selected option at a pixel (2,)."""
        is_same_place = (
            self._at is not None
            and _candidate_names(options) == self._names
            and float(np.hypot(*(at - self._at))) < AT_REST_PX
        )
        return self._index % len(options) if is_same_place else 0

    def selected(self, at: Vector, context: PointerContext) -> PickCandidate | None:
        """Return the option that a press at a pixel (2,) grabs."""
        options = self.candidates_at(at, context)
        return options[self.selected_index(at, options)]

    def select_next(self, at: Vector, context: PointerContext, step: int = 1) -> None:
        """Select the next option at a pixel (2,), or the previous option if ``step`` is -1."""
        options = self.candidates_at(at, context)
        self._index = (self.selected_index(at, options) + step) % len(options)
        self._at, self._names = at, _candidate_names(options)

    def reset(self) -> None:
        """Select the first option again."""
        self._at = None


def _candidate_names(options: tuple[PickCandidate | None, ...]) -> Names:
    return tuple(None if found is None else (found.hit.link, found.kind) for found in options)


_NOTCH_RAD, _NOTCH_M, _FINE = math.radians(1.0), 0.001, 0.1
_LEVEL = 0.3  # if the camera looks up or down more steeply (sine), things move along the table
_KEY_M, _FINE_KEY_M = 0.005, 0.001
_ARROWS = {
    "ArrowLeft": (-1.0, 0.0, 0.0),
    "ArrowRight": (1.0, 0.0, 0.0),
    "ArrowUp": (0.0, 1.0, 0.0),
    "ArrowDown": (0.0, -1.0, 0.0),
    "PageUp": (0.0, 0.0, -1.0),
    "PageDown": (0.0, 0.0, 1.0),
}
_CANCEL_KEYS = ("Escape", " ", "Space")


@dataclass(frozen=True, slots=True, eq=False)
class _GrabbedPoint:
    """A grabbed point of a link, or the tip if ``link`` is None.

    Attributes:
        frame: The link that q moves and that carries the grabbed link, which may be a jaw.
        offset_m: The point (3,) in that link's coordinates.
        depth_m: Depth [m] of the plane parallel to the screen in which the point is dragged.
        offset_px: Offset (2,) from the pixel of the point to the pointer.
        surface: The surface, if any, on which the tip is dragged instead of in that plane.
    """

    camera: Camera
    link: str | None
    frame: str | None
    offset_m: Vector | None
    depth_m: float
    offset_px: Vector
    surface: PictureSurface | None = None

    def make_target(self, px: Vector) -> Target:
        if self.surface is not None:
            return Target(self.surface.point_at(self.camera, px))
        position = self.camera.unproject(px - self.offset_px, self.depth_m)
        return Target(position, frame=self.frame, offset_m=self.offset_m)


@dataclass(frozen=True, slots=True, eq=False)
class MovedThing:
    """An object of the scene that was grabbed.

    Attributes:
        name: The name of the object.
        shift_m: The displacement (3,) in the base frame.
        is_dropped: Whether the object was dropped.
    """

    name: str
    shift_m: Vector
    is_dropped: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class _GrabbedThing:
    """The grabbed point of an object, which moves horizontally or in the plane of a level view."""

    camera: Camera
    point_m: Vector

    def shift_m(self, px: Vector) -> Vector:
        ray, depth_m = self.camera.ray(px), self.camera.depth_of(self.point_m)
        if abs(self.camera.forward[2]) < _LEVEL or ray.direction[2] * self.camera.forward[2] <= 0.0:
            return self.camera.unproject(px, depth_m) - self.point_m
        along_m = (self.point_m[2] - ray.origin_m[2]) / ray.direction[2]
        return ray.at(float(along_m)) - self.point_m


@dataclass(frozen=True, slots=True, eq=False)
class _Fixture:
    """A pressed link that cannot be moved, such as the base."""

    camera: Camera
    found: PickCandidate


class Drag:
    """Converter from pointer, wheel and key events to commands.

    Attributes:
        moved_thing: The object that is dragged, or was dragged last; None after another press.
    """

    def __init__(self, chain: Chain, picker: Picker, objects: Picker | None = None) -> None:
        self._chain, self._hit_tester = chain, HitTester(chain, picker, objects)
        self._selection = CandidateSelection(self._hit_tester)
        self._grabbed: _GrabbedPoint | _GrabbedThing | JointDrag | _Fixture | None = None
        self.moved_thing: MovedThing | None = None
        self._pressed: tuple[Vector, PointerContext] | None = None
        self._pointer = 0
        self._tip_target: Vector | None = None

    @property
    def is_busy(self) -> bool:
        """Whether a drag is in progress."""
        return self._grabbed is not None

    @property
    def camera(self) -> Camera | None:
        """The camera to keep during a drag."""
        return None if self._grabbed is None else self._grabbed.camera

    @property
    def grabbed_link(self) -> str | None:
        """The link that is being dragged."""
        return self._grabbed.link if isinstance(self._grabbed, _GrabbedPoint) else None

    def press(
        self, px: ArrayLike, context: PointerContext, *, shift: bool = False, pointer: int = 0
    ) -> DragCommand | None:
        """Grab the link at a pixel (2,), or with shift its joint; if there is none, move the tip.

        Raises:
            InputError: The pixel in a camera's picture shows neither the table nor a thing.
        """
        if self._grabbed is not None:
            return None
        at = np.asarray(px, dtype=np.float64)
        found = self._selection.selected(at, context)
        self._pointer, self._pressed = pointer, (at, context)
        self.moved_thing = None
        if shift:
            self._grabbed = self._make_joint_drag(at, context, found)
            return None if self._grabbed is None else self._turn_command(self._grabbed)
        if found is not None and found.kind == "object" and context.surface is not None:
            found = None  # the tip moves to the pointer
        if found is not None and found.kind == "object":
            self._grabbed = _GrabbedThing(context.camera, found.hit.point_m)
            self.moved_thing = MovedThing(found.hit.link, np.zeros(3))
            return None
        if found is not None and found.kind != "link":
            self._grabbed = _Fixture(context.camera, found)
            return None
        if found is not None:
            grip = self._grab_link(at, context, found)
        else:  # the tip moves to the pointer in the plane of the view
            camera, tip_m = context.camera, self._chain.forward(context.arms[0])[:3, 3]
            depth_m = camera.depth_of(tip_m if context.plane_m is None else context.plane_m)
            grip = _GrabbedPoint(
                camera, None, None, None, float(depth_m), np.zeros(2), context.surface
            )
        command = self._pull_command(grip, at, is_click=found is None)
        self._grabbed = grip
        return command

    def move(self, px: ArrayLike, pointer: int = 0) -> DragCommand | None:
        """Follow the pointer to a pixel (2,).

        Raises:
            InputError: The pressed thing cannot be moved; raised once per drag.
        """
        if self._grabbed is None or pointer != self._pointer:
            return None
        at = np.asarray(px, dtype=np.float64)
        has_left = (
            self._pressed is not None and float(np.hypot(*(at - self._pressed[0]))) >= AT_REST_PX
        )
        if has_left:
            self._pressed = None
            self._selection.reset()
        if isinstance(self._grabbed, _Fixture):
            if has_left:
                hit = self._grabbed.found.hit
                where = ", ".join(f"{x:z.3f}" for x in hit.point_m.tolist())
                raise InputError(
                    f"{hit.link} cannot be dragged, because no joint moves it; "
                    f"you pressed it at ({where}) m.",
                    "Grab a link of the arm; a click, or N, selects the thing behind it.",
                )
            return None
        if isinstance(self._grabbed, _GrabbedThing):
            if self.moved_thing is not None and self._pressed is None:
                self.moved_thing = replace(self.moved_thing, shift_m=self._grabbed.shift_m(at))
            return None
        if isinstance(self._grabbed, JointDrag):
            self._grabbed = self._grabbed.move_pointer(at)
            return self._turn_command(self._grabbed)
        with suppress(InputError):  # outside the table and the picture, keep the last target
            return self._pull_command(self._grabbed, at, is_click=False)
        return None

    def release(self, pointer: int = 0) -> None:
        """End the drag, keep the last command; a repeated click selects the next thing behind."""
        if pointer != self._pointer:
            return
        self._grabbed = None
        if self.moved_thing is not None:
            self.moved_thing = replace(self.moved_thing, is_dropped=True)
        if self._pressed is not None:
            at, context = self._pressed
            if len(self._selection.candidates_at(at, context)) > 1:
                self._selection.select_next(at, context)
        self._pressed = None

    def cancel(self) -> DragCommand:
        """Cancel the drag, and hold."""
        self._grabbed = self._tip_target = self._pressed = self.moved_thing = None
        self._selection.reset()
        return HoldCommand()

    def wheel(
        self, px: ArrayLike, notches: float, context: PointerContext, *, fine: bool = False
    ) -> DragCommand | None:
        """Move the joint at a pixel (2,) by 1° (a prismatic joint by 1 mm) per notch."""
        at = np.asarray(px, dtype=np.float64)
        dial = self._hit_tester.joint_at(at, context, self._link_under(at, context))
        if dial is None or self.is_busy:
            return None
        notch = (_NOTCH_M if dial.is_prismatic else _NOTCH_RAD) * (_FINE if fine else 1.0)
        self._tip_target = None
        return self._joint_command(
            dial.column, float(context.arms[0][dial.column]) + notches * notch
        )

    def on_key(
        self, key: str, context: PointerContext, *, fine: bool = False
    ) -> DragCommand | None:
        """Move the tip's target by 5 mm (1 mm if fine) along the screen; Escape holds."""
        if key in _CANCEL_KEYS:
            return self.cancel()
        if key not in _ARROWS or self.is_busy:
            return None
        tip = self._chain.forward(context.arms[0])[:3, 3]
        start = tip if self._tip_target is None else self._tip_target
        step_m = _FINE_KEY_M if fine else _KEY_M
        shift = context.camera.R_world_view @ (step_m * np.array(_ARROWS[key]))
        self._tip_target = start + shift
        return DragTarget(Target(self._tip_target))

    def hover(self, px: ArrayLike, context: PointerContext) -> str | None:
        """Return the link that a press at a pixel (2,) would grab."""
        found = self._link_under(np.asarray(px, dtype=np.float64), context)
        return found.hit.link if found else None

    def candidates_under(
        self, px: ArrayLike, context: PointerContext
    ) -> tuple[tuple[PickCandidate | None, ...], int]:
        """Return all options of a press at a pixel (2,), and the selected index.

        None stands for the plane of the view: a click on it moves the tip to that point.
        """
        at = np.asarray(px, dtype=np.float64)
        options = self._selection.candidates_at(at, context)
        return options, self._selection.selected_index(at, options)

    def select_next(self, px: ArrayLike, context: PointerContext, step: int = 1) -> None:
        """Select the next thing behind (``step`` 1) or in front (-1) at a pixel (2,)."""
        self._selection.select_next(np.asarray(px, dtype=np.float64), context, step)

    def set_objects(self, objects: Picker) -> None:
        """Replace the objects of the scene."""
        self._hit_tester.set_objects(objects)

    def _link_under(self, at: Vector, context: PointerContext) -> PickCandidate | None:
        found = self._selection.selected(at, context)
        return found if found is not None and found.kind == "link" else None

    def _grab_link(
        self, at: Vector, context: PointerContext, found: PickCandidate
    ) -> _GrabbedPoint:
        """Grab the hit point, in the frame of the link that q moves."""
        hit = found.hit
        frame = next(s.joint.child for s in reversed(self._chain.joints_to(hit.link)) if s.scale)
        q = context.arms[0] if found.q is None else found.q
        T_world_frame = self._chain.forward(q, frame)
        offset = T_world_frame[:3, :3].T @ (hit.point_m - T_world_frame[:3, 3])
        px, depth_m = context.camera.project(hit.point_m)
        return _GrabbedPoint(context.camera, hit.link, frame, offset, float(depth_m), at - px)

    def _pull_command(self, grip: _GrabbedPoint, at: Vector, *, is_click: bool) -> DragTarget:
        target = grip.make_target(at)
        self._tip_target = target.position if grip.link is None else None
        return DragTarget(target, is_click)

    def _make_joint_drag(
        self, at: Vector, context: PointerContext, found: PickCandidate | None
    ) -> JointDrag | None:
        link = found if found is not None and found.kind == "link" else None
        dial = self._hit_tester.joint_at(at, context, link)
        if dial is None:
            return None
        q = context.arms[0]
        line = dial.pivot_and_axis(self._hit_tester.poses(context))
        point = line[0] if link is None else link.hit.point_m
        now = float(q[dial.column])
        return start_joint_drag(
            dial.column, context.camera, line, at, point, now, slides=dial.is_prismatic
        )

    def _turn_command(self, joint_drag: JointDrag) -> JointTarget:
        self._tip_target = None
        return self._joint_command(joint_drag.column, joint_drag.position)

    def _joint_command(self, column: int, position: float) -> JointTarget:
        low, high = float(self._chain.lower_rad[column]), float(self._chain.upper_rad[column])
        return JointTarget(self._chain.names[column], min(max(position, low), high))
