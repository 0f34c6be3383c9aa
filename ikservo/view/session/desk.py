"""Where visitors' words become wishes: who may, what they mean, and what everybody then sees."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import singledispatchmethod
from typing import Any

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
        self._hear(message, self._visitors[visitor])

    @singledispatchmethod
    def _hear(self, message: Any, visitor: Visitor) -> None:  # noqa: ANN401
        """Act on what only the one in control may say."""
        self._in_control(visitor)
        self._follow_pilot()
        self._pilot.wish = replace(self._pilot.wish, fresh_s=self._clock.now_s())
        try:
            self._move(message, visitor)
        except IkservoError as error:
            raise BadMessageError(error.message, error.command_hint) from error
        self._tell_pilot()

    @_hear.register
    def _(self, message: said.Beat, visitor: Visitor) -> None:
        if visitor.number != self._lease.holder:
            return
        if message.visible:
            self._pilot.wish = replace(self._pilot.wish, fresh_s=self._clock.now_s())
        else:
            self._ground()

    @_hear.register
    def _(self, message: said.Look, visitor: Visitor) -> None:
        if message.view not in views_of(self._posters.stage):
            raise BadMessageError(f"This arm is not seen from the {message.view}.")
        visitor.viewport = Viewport(message.w, message.h, message.dpr)
        if message.view != visitor.view.name:
            visitor.view = View(message.view)

    @_hear.register
    def _(self, message: said.Orbit, visitor: Visitor) -> None:
        view = visitor.view.zoomed(message.zoom)
        if view.name == "orbit":
            view = view.turned(-message.dx * _ORBIT_RAD_PX, message.dy * _ORBIT_RAD_PX)
        elif visitor.viewport is not None:
            view = view.panned((message.dx, message.dy), self._posters.camera(visitor), 0.0)
        visitor.view = view

    @_hear.register
    def _(self, message: said.Stop, visitor: Visitor) -> None:
        del message
        _may_control(visitor)
        self._gestures.forget()
        self._pilot.wish = replace(self._pilot.wish, live=False, goal=None)
        self._pilot.stop("Stopped from the page; torque stays on.")

    @_hear.register
    def _(self, message: said.Acknowledge, visitor: Visitor) -> None:
        del message
        _may_control(visitor)
        self._gestures.forget()
        self._pilot.acknowledge()

    @_hear.register
    def _(self, message: said.Take, visitor: Visitor) -> None:
        _may_control(visitor)
        if message.on and self._lease.holder != visitor.number:
            self._hand_over(visitor.number)
        elif not message.on and self._lease.give(visitor.number):
            self._ground()

    # --- what the one in control wants ---

    def _move(self, message: Message, visitor: Visitor) -> None:
        """Turn a message of the visitor in control into the arm's goal or mode."""
        pilot, gestures = self._pilot, self._gestures
        if isinstance(message, said.Live):
            self._switch(on=message.on)
        elif isinstance(message, said.SpeedChoice):
            pilot.wish = replace(pilot.wish, speed=message.name)
        elif isinstance(message, said.SolverChoice):
            gestures.choose_solver(message.name)
        elif isinstance(message, said.Prefer):
            wanted = Preference(message.pose, message.weights)
            gestures.prefer(wanted, pilot.readout.measured)
        elif isinstance(message, said.Calibrate):
            self._calibrate(message)
        elif isinstance(message, said.Pose):
            gestures.pose(message.name)
        elif visitor.viewport is not None and pilot.readout.trouble is None:
            sight = gestures.sight(
                self._posters.camera(visitor), pilot.readout, self._posters.plane_m(visitor)
            )
            gestures.hear(message, sight, pilot.readout, self._clock.now_s())

    def _switch(self, *, on: bool) -> None:
        """Throw Live: the arm starts from where it stands, whatever the preview showed."""
        pilot = self._pilot
        if on and (pilot.readout.trouble or pilot.readout.talk):
            raise BadMessageError("The arm was stopped.", "Check it, then acknowledge.")
        self._gestures.forget()
        flight = pilot.wish.flight + 1 if on and not pilot.wish.live else pilot.wish.flight
        pilot.wish = replace(pilot.wish, live=on, goal=None, flight=flight)

    def _calibrate(self, message: said.Calibrate) -> None:
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
        self._pilot.wish = replace(self._pilot.wish, speed="slow")

    def _ground(self) -> None:
        self._gestures.forget()
        self._pilot.wish = replace(self._pilot.wish, live=False, goal=None)

    def _tell_pilot(self) -> None:
        wish = self._pilot.wish
        goal = self._gestures.goal
        if wish.live and goal is not wish.goal:
            self._pilot.wish = replace(wish, goal=goal)

    def _in_control(self, visitor: Visitor) -> None:
        _may_control(visitor)
        if visitor.number != self._lease.holder:
            raise BadMessageError("Another page is in control.", "Take control first.")


def _may_control(visitor: Visitor) -> None:
    if visitor.right is not Right.CONTROL:
        raise BadMessageError(
            "This page is for watching only.", "Open the address with the other key."
        )
