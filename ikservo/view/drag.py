"""Dragging: pointer, wheel and keys become targets for the tip, a link or a joint.

Where links, objects and the free plane lie behind each other, a click without a motion, or a key,
goes on to the next; once the pointer is elsewhere, or something else is under it, it is the first
again. None stands for none of them: the tip is to come to the pointer.

A machine without clock, page or servo; every event returns a wish or None::

    drag = Drag(chain, picker)
    wish = drag.press(px, sight, shift=False, pointer=0)    # Pull of the grabbed point, or Turn
    wish = drag.move(px, pointer=0)
    drag.release(pointer=0)
    wish = drag.cancel()                                    # Hold
    wish = drag.wheel(px, notches, sight, fine=False)       # Turn
    wish = drag.key("ArrowUp", sight, fine=False)           # Pull of the tip, Hold for Escape
    link = drag.hover(px, sight)
    options, index = drag.under(px, sight)                  # what lies behind each other there
    drag.go_on(px, sight)                                   # a press means the next of them

A click on a thing that does not move the pointer goes on to the one behind it, too. Touches and
pens are pointers. A pointer beside the one that drags is ignored.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import InputError
from ikservo.ik import Target
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Vector
from ikservo.view.camera import Camera
from ikservo.view.messages import DragCommand, DragTarget, HoldCommand, JointTarget
from ikservo.view.picking import HitTester, PickCandidate, Picker, PointerContext

__all__ = [
    "AT_REST_PX",
    "CandidateSelection",
    "Drag",
    "JointDrag",
    "PointerContext",
    "start_joint_drag",
]


# An axis flatter to the screen than this shows its circle as a line.
_MIN_FACING_COSINE = 0.3
_HUB_PX = 5.0
_MIN_LEVER_PX = 20.0
_LEVERLESS_RAD_PX = math.radians(0.5)
_SMALL = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class JointDrag:
    """A joint that the pointer turns.

    Attributes:
        column: The joint's entry of q.
        camera: The camera the gesture began with.
        pivot_m: A point (3,) of the axis.
        axis: The axis (3,), a unit vector.
        px: Where the pointer was last (2,).
        position: Where the pointer wants the joint, rad or m; may be past its limits, so that a
            pointer which comes back meets the joint where it left it.
        lever_px: How the grabbed point moves on the screen (2,) with the joint, pixels for each
            rad or m; None where the pointer goes round the pivot instead.
    """

    column: int
    camera: Camera
    pivot_m: Vector
    axis: Vector
    px: Vector
    position: float
    lever_px: Vector | None

    def move_pointer(self, px: Vector) -> JointDrag:
        """Return the gesture after the pointer has moved to a pixel (2,)."""
        return replace(self, px=px, position=self.position + self._angle_change(px))

    def _angle_change(self, px: Vector) -> float:
        if self.lever_px is not None:
            return float((px - self.px) @ self.lever_px) / float(self.lever_px @ self.lever_px)
        before, now = self._pointer_angle(self.px), self._pointer_angle(px)
        return 0.0 if before is None or now is None else math.remainder(now - before, math.tau)

    def _pointer_angle(self, px: Vector) -> float | None:
        """Return the pointer's angle about the axis; None on the pivot, where it has none."""
        hub, _ = self.camera.project(self.pivot_m)
        met = self.camera.ray(px).intersect_plane(self.pivot_m, self.axis)
        if met is None or float(np.hypot(*(px - hub))) < _HUB_PX:
            return None
        across = self.camera.right - self.axis * float(self.axis @ self.camera.right)
        if float(across @ across) < 0.1:
            across = self.camera.up - self.axis * float(self.axis @ self.camera.up)
        arm = met - self.pivot_m
        return math.atan2(float(np.cross(self.axis, across) @ arm), float(across @ arm))


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
    """Begin to turn a joint.

    Args:
        column: The joint's entry of q.
        camera: What the person sees.
        line: A point (3,) of the axis, and its direction (3,).
        px: Where the pointer is (2,).
        point_m: The grabbed point (3,).
        position: The joint's position, rad or m.
        slides: Whether the joint is a slide.
    """
    pivot, axis = line
    sight = camera.ray(camera.project(pivot)[0]).direction
    lever = None
    if slides or abs(float(sight @ axis)) < _MIN_FACING_COSINE:
        lever = _screen_velocity(
            camera, axis if slides else np.cross(axis, point_m - pivot), point_m
        )
    return JointDrag(column, camera, pivot, axis, px, position, lever)


def _screen_velocity(camera: Camera, velocity: Vector, point_m: Vector) -> Vector:
    """Return how a point moves on the screen (2,) at a velocity (3,); upwards if hardly at all."""
    ends, _ = camera.project(point_m + np.array([[-_SMALL], [_SMALL]]) * velocity)
    lever: Vector = (ends[1] - ends[0]) / (2.0 * _SMALL)
    upwards = np.array([0.0, -1.0 / _LEVERLESS_RAD_PX])
    return lever if float(lever @ lever) > _MIN_LEVER_PX**2 else upwards


AT_REST_PX = 4.0
"""A pointer that moves less stays where it is."""

Names = tuple[tuple[str, str] | None, ...]


class CandidateSelection:
    """Remembers which of the things under a resting pointer is chosen.

    Args:
        under: Finds them.
    """

    def __init__(self, under: HitTester) -> None:
        self._under = under
        self._at: Vector | None = None
        self._names: Names = ()
        self._index = 0

    def candidates_at(self, at: Vector, sight: PointerContext) -> tuple[PickCandidate | None, ...]:
        """Return what a press at a pixel (2,) may mean: links, objects, None, what is fixed."""
        found = self._under.candidates_at(at, sight)
        fixed = tuple(each for each in found if each.kind == "fixed")
        return (*found[: len(found) - len(fixed)], None, *fixed)

    def selected_index(self, at: Vector, options: tuple[PickCandidate | None, ...]) -> int:
        """Return which of the options at a pixel (2,) is chosen."""
        return (
            self._index % len(options) if self._is_same_place(at, _candidate_names(options)) else 0
        )

    def selected(self, at: Vector, sight: PointerContext) -> PickCandidate | None:
        """Return what a press at a pixel (2,) means."""
        options = self.candidates_at(at, sight)
        return options[self.selected_index(at, options)]

    def select_next(self, at: Vector, sight: PointerContext, step: int = 1) -> None:
        """Choose the next, or with -1 the one before, at a pixel (2,)."""
        options = self.candidates_at(at, sight)
        self._index = (self.selected_index(at, options) + step) % len(options)
        self._at, self._names = at, _candidate_names(options)

    def reset(self) -> None:
        """Choose the first again."""
        self._at = None

    def _is_same_place(self, at: Vector, names: Names) -> bool:
        if self._at is None or names != self._names:
            return False
        return float(np.hypot(*(at - self._at))) < AT_REST_PX


def _candidate_names(options: tuple[PickCandidate | None, ...]) -> Names:
    return tuple(None if found is None else (found.hit.link, found.kind) for found in options)


_NOTCH_RAD, _NOTCH_M, _FINE = math.radians(1.0), 0.001, 0.1
_KEY_M, _FINE_KEY_M = 0.005, 0.001
_ARROWS = {
    "ArrowLeft": (-1.0, 0.0, 0.0),
    "ArrowRight": (1.0, 0.0, 0.0),
    "ArrowUp": (0.0, 1.0, 0.0),
    "ArrowDown": (0.0, -1.0, 0.0),
    "PageUp": (0.0, 0.0, -1.0),
    "PageDown": (0.0, 0.0, 1.0),
}
_GRAB_KINDS = ("Escape", " ", "Space")


@dataclass(frozen=True, slots=True, eq=False)
class _GrabbedPoint:
    """A point of a link that the pointer holds, or the tip where ``link`` is None.

    Attributes:
        frame: The link that q moves and that carries the grabbed one: a jaw is not its own.
        offset_m: The point (3,) in that link's coordinates.
        depth_m: How deep in the picture it stays: the plane parallel to the screen.
        slip_px: From the pixel of the point to the pointer's (2,).
    """

    camera: Camera
    link: str | None
    frame: str | None
    offset_m: Vector | None
    depth_m: float
    slip_px: Vector

    def make_target(self, px: Vector) -> Target:
        position = self.camera.unproject(px - self.slip_px, self.depth_m)
        return Target(position, frame=self.frame, offset_m=self.offset_m)


@dataclass(frozen=True, slots=True, eq=False)
class _Fixture:
    """A thing that is pressed and cannot be moved: an object of the scene, or the base."""

    camera: Camera
    found: PickCandidate


class Drag:
    """Turns what a person does into what they want.

    Args:
        chain: The arm, inside its own limits.
        picker: Finds its links.
        objects: Finds the objects of the scene, in the base frame; None for none.
    """

    def __init__(self, chain: Chain, picker: Picker, objects: Picker | None = None) -> None:
        self._chain, self._under = chain, HitTester(chain, picker, objects)
        self._choosing = CandidateSelection(self._under)
        self._held: _GrabbedPoint | JointDrag | _Fixture | None = None
        self._pressed: tuple[Vector, PointerContext] | None = None
        self._pointer = 0
        self._tip_target: Vector | None = None

    @property
    def is_busy(self) -> bool:
        """Return whether a pointer holds something."""
        return self._held is not None

    @property
    def camera(self) -> Camera | None:
        """Return the camera to keep while a drag lasts."""
        return None if self._held is None else self._held.camera

    @property
    def grabbed_link(self) -> str | None:
        """Return the link that is being pulled."""
        return self._held.link if isinstance(self._held, _GrabbedPoint) else None

    def press(
        self, px: ArrayLike, sight: PointerContext, *, shift: bool = False, pointer: int = 0
    ) -> DragCommand | None:
        """Grab the link at a pixel (2,), send the tip there, or with shift grab its joint."""
        if self._held is not None:
            return None
        at = np.asarray(px, dtype=np.float64)
        found = self._choosing.selected(at, sight)
        self._pointer, self._pressed = pointer, (at, sight)
        if shift:
            self._held = self._make_joint_drag(at, sight, found)
            return None if self._held is None else self._turn_command(self._held)
        if found is not None and found.kind != "link":
            self._held = _Fixture(sight.camera, found)
            return None
        self._held = (
            self._grab_tip(at, sight) if found is None else self._grab_link(at, sight, found)
        )
        return self._pull_command(self._held, at, jump=found is None)

    def move(self, px: ArrayLike, pointer: int = 0) -> DragCommand | None:
        """Follow the pointer to a pixel (2,).

        Raises:
            InputError: What is held cannot be moved; said once.
        """
        if self._held is None or pointer != self._pointer:
            return None
        at = np.asarray(px, dtype=np.float64)
        first = self._has_left_press(at)
        if isinstance(self._held, _Fixture):
            if first:
                raise _fixed_error(self._held.found)
            return None
        if isinstance(self._held, JointDrag):
            self._held = self._held.move_pointer(at)
            return self._turn_command(self._held)
        return self._pull_command(self._held, at, jump=False)

    def release(self, pointer: int = 0) -> None:
        """Let go; the last wish stands. What was only clicked gives way to what is behind it."""
        if pointer != self._pointer:
            return
        self._held = None
        if self._pressed is not None:
            at, sight = self._pressed
            if len(self._choosing.candidates_at(at, sight)) > 1:
                self._choosing.select_next(at, sight)
        self._pressed = None

    def cancel(self) -> DragCommand:
        """Let go, and hold."""
        self._held = self._tip_target = self._pressed = None
        self._choosing.reset()
        return HoldCommand()

    def wheel(
        self, px: ArrayLike, notches: float, sight: PointerContext, *, fine: bool = False
    ) -> DragCommand | None:
        """Turn the joint at a pixel (2,) by a degree (a slide by 1 mm) for each notch."""
        at = np.asarray(px, dtype=np.float64)
        dial = self._under.joint_at(at, sight, self._link_under(at, sight))
        if dial is None or self.is_busy:
            return None
        notch = (_NOTCH_M if dial.is_prismatic else _NOTCH_RAD) * (_FINE if fine else 1.0)
        self._tip_target = None
        return self._joint_command(dial.column, float(sight.arms[0][dial.column]) + notches * notch)

    def on_key(self, key: str, sight: PointerContext, *, fine: bool = False) -> DragCommand | None:
        """Move the tip's target 5 mm (1 mm if fine) on the screen by an arrow; Escape holds."""
        if key in _GRAB_KINDS:
            return self.cancel()
        if key not in _ARROWS or self.is_busy:
            return None
        tip = self._chain.forward(sight.arms[0])[:3, 3]
        start = tip if self._tip_target is None else self._tip_target
        step_m = _FINE_KEY_M if fine else _KEY_M
        shift = sight.camera.R_world_view @ (step_m * np.array(_ARROWS[key]))
        self._tip_target = start + shift
        return DragTarget(Target(self._tip_target))

    def hover(self, px: ArrayLike, sight: PointerContext) -> str | None:
        """Return the link that a press at a pixel (2,) would grab."""
        found = self._link_under(np.asarray(px, dtype=np.float64), sight)
        return found.hit.link if found else None

    def candidates_under(
        self, px: ArrayLike, sight: PointerContext
    ) -> tuple[tuple[PickCandidate | None, ...], int]:
        """Return all that a press at a pixel (2,) may mean, and which of it is chosen.

        None stands for the plane that the view shows: the tip is to come there.
        """
        at = np.asarray(px, dtype=np.float64)
        options = self._choosing.candidates_at(at, sight)
        return options, self._choosing.selected_index(at, options)

    def select_next(self, px: ArrayLike, sight: PointerContext, step: int = 1) -> None:
        """Let a press at a pixel (2,) mean what is behind, or with -1 before, what it means now."""
        self._choosing.select_next(np.asarray(px, dtype=np.float64), sight, step)

    def _has_left_press(self, at: Vector) -> bool:
        """Return whether the pointer has just moved away from where it was pressed."""
        if self._pressed is None or float(np.hypot(*(at - self._pressed[0]))) < AT_REST_PX:
            return False
        self._pressed = None
        self._choosing.reset()
        return True

    def _link_under(self, at: Vector, sight: PointerContext) -> PickCandidate | None:
        found = self._choosing.selected(at, sight)
        return found if found is not None and found.kind == "link" else None

    def _grab_link(self, at: Vector, sight: PointerContext, found: PickCandidate) -> _GrabbedPoint:
        """Grab the point that was hit, where it is fixed to what q moves."""
        hit = found.hit
        frame = next(s.joint.child for s in reversed(self._chain.joints_to(hit.link)) if s.scale)
        q = sight.arms[0] if found.q is None else found.q
        T_world_frame = self._chain.forward(q, frame)
        offset = T_world_frame[:3, :3].T @ (hit.point_m - T_world_frame[:3, 3])
        px, depth_m = sight.camera.project(hit.point_m)
        return _GrabbedPoint(sight.camera, hit.link, frame, offset, float(depth_m), at - px)

    def _grab_tip(self, at: Vector, sight: PointerContext) -> _GrabbedPoint:
        """Grab the tip, which is to come to the pointer on the plane that the view shows."""
        tip = self._chain.forward(sight.arms[0])[:3, 3]
        depth = sight.camera.depth_of(tip if sight.plane_m is None else sight.plane_m)
        return _GrabbedPoint(sight.camera, None, None, None, float(depth), np.zeros(2))

    def _pull_command(self, grip: _GrabbedPoint, at: Vector, *, jump: bool) -> DragTarget:
        target = grip.make_target(at)
        self._tip_target = target.position if grip.link is None else None
        return DragTarget(target, jump)

    def _make_joint_drag(
        self, at: Vector, sight: PointerContext, found: PickCandidate | None
    ) -> JointDrag | None:
        link = found if found is not None and found.kind == "link" else None
        dial = self._under.joint_at(at, sight, link)
        if dial is None:
            return None
        q = sight.arms[0]
        line = dial.pivot_and_axis(self._under.poses(sight))
        point = line[0] if link is None else link.hit.point_m
        now = float(q[dial.column])
        return start_joint_drag(
            dial.column, sight.camera, line, at, point, now, slides=dial.is_prismatic
        )

    def _turn_command(self, turning: JointDrag) -> JointTarget:
        self._tip_target = None
        return self._joint_command(turning.column, turning.position)

    def _joint_command(self, column: int, position: float) -> JointTarget:
        low, high = float(self._chain.lower_rad[column]), float(self._chain.upper_rad[column])
        return JointTarget(self._chain.names[column], min(max(position, low), high))


def _fixed_error(found: PickCandidate) -> InputError:
    """Say why a thing cannot be dragged."""
    where = ", ".join(f"{x:z.3f}" for x in found.hit.point_m.tolist())
    what = "an object of the scene" if found.kind == "object" else "a link that no joint moves"
    return InputError(
        f"{found.hit.link} cannot be dragged: it is {what}, pressed at ({where}) m.",
        "Grab a link of the arm; a click, or N, chooses what is behind.",
    )
