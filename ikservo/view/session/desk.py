"""Where visitors' words become wishes: who may, what they mean, and what everybody then sees."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from ikservo.arm.streaming.halt import StopKind, StopReason
from ikservo.clock import Clock
from ikservo.errors import IkservoError
from ikservo.view.camera.camera import Viewport
from ikservo.view.camera.views import View, views_of
from ikservo.view.scene.posters import Posters
from ikservo.view.server import messages as said
from ikservo.view.server.lease import Lease
from ikservo.view.server.messages import BadMessageError, Message
from ikservo.view.server.server import Frame
from ikservo.view.server.visitor import Visitor
from ikservo.view.server.visitors import Right
from ikservo.view.session.gestures import Gestures
from ikservo.view.session.pilot import Pilot
from ikservo.view.session.preference import Preference

__all__ = ["Desk"]

_ORBIT_RAD_PX = 0.008
_STOPPED = StopReason(StopKind.CLIENT, "Stopped from the page; torque stays on.")

Handler = Callable[[Any, Visitor], None]
"""Acts on one type of message."""


class Desk:
    """Hears all visitors and moves the arm for the one in control (``server.Audience``).

    All of it runs in the server's thread; the pilot's wishes and sights are replaced as a whole.

    Args:
        pilot: Owns the arm.
        clock: Dates signs of life.
    """

    def __init__(self, pilot: Pilot, clock: Clock) -> None:
        self._pilot, self._clock = pilot, clock
        self._arm = pilot.arm
        self._gestures = Gestures(pilot.arm)
        self._posters = Posters(pilot, self._gestures, clock)
        self._lease = Lease()
        self._visitors: dict[int, Visitor] = {}
        self._numbers = itertools.count(1)
        self._handlers: dict[type, Handler] = {
            said.Beat: self._beat,
            said.Look: self._look,
            said.Orbit: self._orbit,
            said.Stop: self._stop,
            said.Acknowledge: self._acknowledge,
            said.Take: self._take,
        }
        # Only the visitor in control may say these, and all that is in neither table.
        self._control_handlers: dict[type, Handler] = {
            said.Live: self._switch_live,
            said.SpeedChoice: self._choose_speed,
            said.SolverChoice: self._choose_solver,
            said.Prefer: self._prefer,
            said.Calibrate: self._calibrate,
            said.Pose: self._pose,
        }

    def close(self) -> None:
        """Leave what is being worked out in the background."""
        self._posters.close()

    # --- visitors come and go ---

    def join(self, right: Right) -> int:
        """Let a visitor in; the first who may control does."""
        number = next(self._numbers)
        view = View(views_of(self._posters.stage)[0])
        self._visitors[number] = Visitor(number, right, view)
        if right is Right.CONTROL and self._lease.holder is None:
            self._hand_over(number)
        return number

    def leave(self, visitor: int) -> None:
        """Forget a visitor; an arm that it moved holds."""
        del self._visitors[visitor]
        if self._lease.give(visitor):
            self._ground()

    def frames(self, visitor: int) -> list[Frame]:
        """Return what is new for a visitor."""
        self._follow_pilot()
        if visitor == self._lease.holder:
            self._gestures.go_on(self._pilot.readout, self._clock.now_s())
            self._tell_pilot()
        held = {None: "none", visitor: "you"}.get(self._lease.holder, "other")
        return self._posters.frames(self._visitors[visitor], controller=held)

    # --- what they say ---

    def receive(self, visitor: int, message: Message) -> None:
        """Act on what a visitor says.

        Raises:
            BadMessageError: It may not, or it makes no sense now; nothing has changed.
        """
        sender, handle = self._visitors[visitor], self._handlers.get(type(message))
        if handle is None:
            self._receive_in_control(message, sender)
        else:
            handle(message, sender)

    def _beat(self, message: said.Beat, visitor: Visitor) -> None:
        if visitor.number != self._lease.holder:
            return
        if message.visible:
            self._pilot.post(replace(self._pilot.wish, fresh_s=self._clock.now_s()))
        else:
            self._ground()

    def _look(self, message: said.Look, visitor: Visitor) -> None:
        if message.view not in views_of(self._posters.stage):
            raise BadMessageError(f"This arm is not seen from the {message.view}.")
        visitor.viewport = Viewport(message.w, message.h, message.dpr)
        if message.view != visitor.view.name:
            visitor.view = View(message.view)

    def _orbit(self, message: said.Orbit, visitor: Visitor) -> None:
        view = visitor.view.zoomed(message.zoom)
        if view.name == "orbit":
            view = view.turned(-message.dx * _ORBIT_RAD_PX, message.dy * _ORBIT_RAD_PX)
        elif visitor.viewport is not None:
            view = view.panned((message.dx, message.dy), self._posters.camera(visitor), 0.0)
        visitor.view = view

    def _stop(self, _message: said.Stop, visitor: Visitor) -> None:
        _may_control(visitor)
        self._gestures.forget()
        self._pilot.post(replace(self._pilot.wish, live=False, goal=None))
        self._pilot.request_stop(_STOPPED)

    def _acknowledge(self, _message: said.Acknowledge, visitor: Visitor) -> None:
        _may_control(visitor)
        self._gestures.forget()
        self._pilot.acknowledge()

    def _take(self, message: said.Take, visitor: Visitor) -> None:
        _may_control(visitor)
        if message.on and self._lease.holder != visitor.number:
            self._hand_over(visitor.number)
        elif not message.on and self._lease.give(visitor.number):
            self._ground()

    # --- what the one in control wants ---

    def _receive_in_control(self, message: Message, visitor: Visitor) -> None:
        """Turn what only the visitor in control may say into the arm's goal or mode."""
        self._in_control(visitor)
        self._follow_pilot()
        self._pilot.post(replace(self._pilot.wish, fresh_s=self._clock.now_s()))
        handle = self._control_handlers.get(type(message), self._gesture)
        try:
            handle(message, visitor)
        except IkservoError as error:
            raise BadMessageError(error.message, error.command_hint) from error
        self._tell_pilot()

    def _choose_speed(self, message: said.SpeedChoice, _visitor: Visitor) -> None:
        self._pilot.post(replace(self._pilot.wish, speed=message.name))

    def _choose_solver(self, message: said.SolverChoice, _visitor: Visitor) -> None:
        self._gestures.choose_solver(message.name)

    def _prefer(self, message: said.Prefer, _visitor: Visitor) -> None:
        wanted = Preference(message.pose, message.weights)
        self._gestures.prefer(wanted, self._pilot.readout.measured)

    def _pose(self, message: said.Pose, _visitor: Visitor) -> None:
        self._gestures.pose(message.name, self._pilot.readout.measured)

    def _gesture(self, message: Any, visitor: Visitor) -> None:  # noqa: ANN401
        """Hear every other message: what a pointer, a key or a stick does in the drawing."""
        readout = self._pilot.readout
        if visitor.viewport is None or readout.trouble is not None:
            return
        camera, plane_m = self._posters.camera(visitor), self._posters.plane_m(visitor)
        sight = self._gestures.sight(camera, readout, plane_m)
        self._gestures.hear(message, sight, readout, self._clock.now_s())

    def _switch_live(self, message: said.Live, _visitor: Visitor) -> None:
        """Throw Live: the arm starts from where it stands, whatever the preview showed."""
        pilot, on = self._pilot, message.on
        if on and (pilot.readout.trouble or pilot.readout.talk):
            raise BadMessageError("The arm was stopped.", "Check it, then acknowledge.")
        self._gestures.forget()
        flight = pilot.wish.flight + 1 if on and not pilot.wish.live else pilot.wish.flight
        pilot.post(replace(pilot.wish, live=on, goal=None, flight=flight))

    def _calibrate(self, message: said.Calibrate, _visitor: Visitor) -> None:
        ritual = self._pilot.ritual
        if ritual is None or (self._pilot.wish.live and message.word == "begin"):
            raise BadMessageError("The arm cannot be calibrated now.", "Switch Live off first.")
        if message.word == "begin":
            ritual.begin()
        else:
            ritual.answer(f"{message.word} {message.joint or ''}".strip())

    def _follow_pilot(self) -> None:
        """Notice that a flight has ended; what it went for is forgotten with it."""
        if self._pilot.arm is not self._arm:
            self._furnish()
        wish, readout = self._pilot.wish, self._pilot.readout
        if wish.live and readout.ended >= wish.flight:
            self._ground()

    def _furnish(self) -> None:
        """Begin anew with an arm that was opened again: its limits may be others."""
        self._arm = self._pilot.arm
        self._posters.close()
        self._gestures = Gestures(self._arm)
        self._posters = Posters(self._pilot, self._gestures, self._clock)

    def _hand_over(self, visitor: int) -> None:
        """Give control to a visitor, who begins slowly and with a preview."""
        self._lease.take(visitor)
        self._ground()
        self._pilot.post(replace(self._pilot.wish, speed="slow"))

    def _ground(self) -> None:
        self._gestures.forget()
        self._pilot.post(replace(self._pilot.wish, live=False, goal=None))

    def _tell_pilot(self) -> None:
        wish = self._pilot.wish
        goal = self._gestures.goal
        if wish.live and goal is not wish.goal:
            self._pilot.post(replace(wish, goal=goal))

    def _in_control(self, visitor: Visitor) -> None:
        _may_control(visitor)
        if visitor.number != self._lease.holder:
            raise BadMessageError("Another page is in control.", "Take control first.")


def _may_control(visitor: Visitor) -> None:
    if visitor.right is not Right.CONTROL:
        raise BadMessageError(
            "This page is for watching only.", "Open the address with the other key."
        )
