"""Pointer, wheel and keys become wishes: press any part, pull, the arm follows (lecture L19).

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
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import InputError
from ikservo.ik import Target
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Vector
from ikservo.view.camera.camera import Camera
from ikservo.view.drag.choosing import STILL_PX, Choosing
from ikservo.view.drag.turning import Turning, begin
from ikservo.view.drag.wishes import Hold, Pull, Turn, Wish
from ikservo.view.pick.pick import Picker
from ikservo.view.pick.under import Found, Sight, Under

__all__ = ["Drag", "Sight"]

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
_HOLDS = ("Escape", " ", "Space")


@dataclass(frozen=True, slots=True, eq=False)
class _Grip:
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

    def target(self, px: Vector) -> Target:
        position = self.camera.unproject(px - self.slip_px, self.depth_m)
        return Target(position, frame=self.frame, offset_m=self.offset_m)


@dataclass(frozen=True, slots=True, eq=False)
class _Fixture:
    """A thing that is pressed and cannot be moved: an object of the scene, or the base."""

    camera: Camera
    found: Found


class Drag:
    """Turns what a person does into what they want.

    Args:
        chain: The arm, inside its own limits.
        picker: Finds its links.
        objects: Finds the objects of the scene, in the base frame; None for none.
    """

    def __init__(self, chain: Chain, picker: Picker, objects: Picker | None = None) -> None:
        self._chain, self._under = chain, Under(chain, picker, objects)
        self._choosing = Choosing(self._under)
        self._held: _Grip | Turning | _Fixture | None = None
        self._pressed: tuple[Vector, Sight] | None = None
        self._pointer = 0
        self._tip_target: Vector | None = None

    @property
    def busy(self) -> bool:
        """Return whether a pointer holds something."""
        return self._held is not None

    @property
    def camera(self) -> Camera | None:
        """Return the camera to keep while a drag lasts."""
        return None if self._held is None else self._held.camera

    @property
    def grabbed(self) -> str | None:
        """Return the link that is being pulled."""
        return self._held.link if isinstance(self._held, _Grip) else None

    def press(
        self, px: ArrayLike, sight: Sight, *, shift: bool = False, pointer: int = 0
    ) -> Wish | None:
        """Grab the link at a pixel (2,), send the tip there, or with shift grab its joint."""
        if self._held is not None:
            return None
        at = np.asarray(px, dtype=np.float64)
        found = self._choosing.chosen(at, sight)
        self._pointer, self._pressed = pointer, (at, sight)
        if shift:
            self._held = self._turning(at, sight, found)
            return None if self._held is None else self._turn(self._held)
        if found is not None and found.kind != "link":
            self._held = _Fixture(sight.camera, found)
            return None
        self._held = (
            self._on_nothing(at, sight) if found is None else self._on_link(at, sight, found)
        )
        return self._pull(self._held, at, jump=found is None)

    def move(self, px: ArrayLike, pointer: int = 0) -> Wish | None:
        """Follow the pointer to a pixel (2,).

        Raises:
            InputError: What is held cannot be moved; said once.
        """
        if self._held is None or pointer != self._pointer:
            return None
        at = np.asarray(px, dtype=np.float64)
        first = self._leaves(at)
        if isinstance(self._held, _Fixture):
            if first:
                raise _fixed(self._held.found)
            return None
        if isinstance(self._held, Turning):
            self._held = self._held.moved(at)
            return self._turn(self._held)
        return self._pull(self._held, at, jump=False)

    def release(self, pointer: int = 0) -> None:
        """Let go; the last wish stands. What was only clicked gives way to what is behind it."""
        if pointer != self._pointer:
            return
        self._held = None
        if self._pressed is not None:
            at, sight = self._pressed
            if len(self._choosing.options(at, sight)) > 1:
                self._choosing.go_on(at, sight)
        self._pressed = None

    def cancel(self) -> Wish:
        """Let go, and hold."""
        self._held = self._tip_target = self._pressed = None
        self._choosing.forget()
        return Hold()

    def wheel(
        self, px: ArrayLike, notches: float, sight: Sight, *, fine: bool = False
    ) -> Wish | None:
        """Turn the joint at a pixel (2,) by a degree (a slide by 1 mm) for each notch."""
        at = np.asarray(px, dtype=np.float64)
        dial = self._under.dial(at, sight, self._link(at, sight))
        if dial is None or self.busy:
            return None
        notch = (_NOTCH_M if dial.slides else _NOTCH_RAD) * (_FINE if fine else 1.0)
        self._tip_target = None
        return self._to(dial.column, float(sight.arms[0][dial.column]) + notches * notch)

    def key(self, key: str, sight: Sight, *, fine: bool = False) -> Wish | None:
        """Move the tip's target 5 mm (1 mm if fine) on the screen by an arrow; Escape holds."""
        if key in _HOLDS:
            return self.cancel()
        if key not in _ARROWS or self.busy:
            return None
        tip = self._chain.forward(sight.arms[0])[:3, 3]
        start = tip if self._tip_target is None else self._tip_target
        step_m = _FINE_KEY_M if fine else _KEY_M
        shift = sight.camera.R_world_view @ (step_m * np.array(_ARROWS[key]))
        self._tip_target = start + shift
        return Pull(Target(self._tip_target))

    def hover(self, px: ArrayLike, sight: Sight) -> str | None:
        """Return the link that a press at a pixel (2,) would grab."""
        found = self._link(np.asarray(px, dtype=np.float64), sight)
        return found.hit.link if found else None

    def under(self, px: ArrayLike, sight: Sight) -> tuple[tuple[Found | None, ...], int]:
        """Return all that a press at a pixel (2,) may mean, and which of it is chosen.

        None stands for the plane that the view shows: the tip is to come there.
        """
        at = np.asarray(px, dtype=np.float64)
        options = self._choosing.options(at, sight)
        return options, self._choosing.index(at, options)

    def go_on(self, px: ArrayLike, sight: Sight, step: int = 1) -> None:
        """Let a press at a pixel (2,) mean what is behind, or with -1 before, what it means now."""
        self._choosing.go_on(np.asarray(px, dtype=np.float64), sight, step)

    def _leaves(self, at: Vector) -> bool:
        """Return whether the pointer has just moved away from where it was pressed."""
        if self._pressed is None or float(np.hypot(*(at - self._pressed[0]))) < STILL_PX:
            return False
        self._pressed = None
        self._choosing.forget()
        return True

    def _link(self, at: Vector, sight: Sight) -> Found | None:
        found = self._choosing.chosen(at, sight)
        return found if found is not None and found.kind == "link" else None

    def _on_link(self, at: Vector, sight: Sight, found: Found) -> _Grip:
        """Grab the point that was hit, where it is fixed to what q moves."""
        hit = found.hit
        frame = next(s.joint.child for s in reversed(self._chain.way(hit.link)) if s.scale)
        q = sight.arms[0] if found.q is None else found.q
        T_world_frame = self._chain.forward(q, frame)
        offset = T_world_frame[:3, :3].T @ (hit.point_m - T_world_frame[:3, 3])
        px, depth_m = sight.camera.project(hit.point_m)
        return _Grip(sight.camera, hit.link, frame, offset, float(depth_m), at - px)

    def _on_nothing(self, at: Vector, sight: Sight) -> _Grip:
        """Grab the tip, which is to come to the pointer on the plane that the view shows."""
        tip = self._chain.forward(sight.arms[0])[:3, 3]
        depth = sight.camera.depth_of(tip if sight.plane_m is None else sight.plane_m)
        return _Grip(sight.camera, None, None, None, float(depth), np.zeros(2))

    def _pull(self, grip: _Grip, at: Vector, *, jump: bool) -> Pull:
        target = grip.target(at)
        self._tip_target = target.position if grip.link is None else None
        return Pull(target, jump)

    def _turning(self, at: Vector, sight: Sight, found: Found | None) -> Turning | None:
        link = found if found is not None and found.kind == "link" else None
        dial = self._under.dial(at, sight, link)
        if dial is None:
            return None
        q = sight.arms[0]
        line = dial.place(self._under.poses(sight))
        point = line[0] if link is None else link.hit.point_m
        now = float(q[dial.column])
        return begin(dial.column, sight.camera, line, at, point, now, slides=dial.slides)

    def _turn(self, turning: Turning) -> Turn:
        self._tip_target = None
        return self._to(turning.column, turning.position)

    def _to(self, column: int, position: float) -> Turn:
        low, high = float(self._chain.lower_rad[column]), float(self._chain.upper_rad[column])
        return Turn(self._chain.names[column], min(max(position, low), high))


def _fixed(found: Found) -> InputError:
    """Say why a thing cannot be dragged."""
    where = ", ".join(f"{x:z.3f}" for x in found.hit.point_m.tolist())
    what = "an object of the scene" if found.kind == "object" else "a link that no joint moves"
    return InputError(
        f"{found.hit.link} cannot be dragged: it is {what}, pressed at ({where}) m.",
        "Grab a link of the arm; a click, or N, chooses what is behind.",
    )
