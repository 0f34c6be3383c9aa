"""The session controller: what a client may do and what its messages change."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from ikservo.arm import StopKind, StopReason
from ikservo.clock import Clock
from ikservo.errors import IkservoError
from ikservo.view import messages as said
from ikservo.view.arm_thread import ArmThread
from ikservo.view.auth import Permission
from ikservo.view.camera import Viewport
from ikservo.view.connection import Client, ControlLease
from ikservo.view.frames import FrameComposer
from ikservo.view.interaction import Interaction, PosturePreference
from ikservo.view.messages import BadMessageError, Message
from ikservo.view.server import Frame
from ikservo.view.viewpoints import Viewpoint, available_views

__all__ = ["SessionController"]

_ORBIT_RAD_PX = 0.008
_STOPPED = StopReason(StopKind.CLIENT, "Stopped from the page; torque stays on.")

Handler = Callable[[Any, Client], None]
"""Acts on one type of message."""


class SessionController:
    """Hears all visitors and moves the arm for the one in control (``server.Audience``).

    All of it runs in the server's thread; the pilot's wishes and sights are replaced as a whole.

    Args:
        pilot: Owns the arm.
        clock: Dates signs of life.
    """

    def __init__(self, pilot: ArmThread, clock: Clock) -> None:
        self._pilot, self._clock = pilot, clock
        self._arm = pilot.arm
        self._gestures = Interaction(pilot.arm)
        self._posters = FrameComposer(pilot, self._gestures, clock)
        self._lease = ControlLease()
        self._visitors: dict[int, Client] = {}
        self._numbers = itertools.count(1)
        self._handlers: dict[type, Handler] = {
            said.Heartbeat: self._refresh_heartbeat,
            said.SetViewport: self._look,
            said.OrbitCamera: self._orbit,
            said.Stop: self._stop,
            said.Acknowledge: self._acknowledge,
            said.TakeControl: self._take,
        }
        # Only the visitor in control may say these, and all that is in neither table.
        self._control_handlers: dict[type, Handler] = {
            said.SetLive: self._switch_live,
            said.SetSpeed: self._choose_speed,
            said.SetSolver: self._choose_solver,
            said.PreferPosture: self._prefer,
            said.CalibrationAnswer: self._handle_calibration,
            said.GoToPose: self._pose,
        }

    def close(self) -> None:
        """Leave what is being worked out in the background."""
        self._posters.close()

    # --- visitors come and go ---

    def connect(self, right: Permission) -> int:
        """Let a visitor in; the first who may control does."""
        number = next(self._numbers)
        view = Viewpoint(available_views(self._posters.stage)[0])
        self._visitors[number] = Client(number, right, view)
        if right is Permission.CONTROL and self._lease.holder is None:
            self._grant_control(number)
        return number

    def disconnect(self, visitor: int) -> None:
        """Forget a visitor; an arm that it moved holds."""
        del self._visitors[visitor]
        if self._lease.release(visitor):
            self._stop_session()

    def frames(self, visitor: int) -> list[Frame]:
        """Return what is new for a visitor."""
        self._update_after_session()
        if visitor == self._lease.holder:
            self._gestures.continue_target(self._pilot.readout, self._clock.now_s())
            self._send_setpoint()
        held = {None: "none", visitor: "you"}.get(self._lease.holder, "other")
        return self._posters.compose(self._visitors[visitor], controller=held)

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

    def _refresh_heartbeat(self, message: said.Heartbeat, visitor: Client) -> None:
        if visitor.number != self._lease.holder:
            return
        if message.visible:
            self._pilot.post(replace(self._pilot.command, heartbeat_s=self._clock.now_s()))
        else:
            self._stop_session()

    def _look(self, message: said.SetViewport, visitor: Client) -> None:
        if message.view not in available_views(self._posters.stage):
            raise BadMessageError(f"This arm is not seen from the {message.view}.")
        visitor.viewport = Viewport(message.w, message.h, message.dpr)
        if message.view != visitor.view.name:
            visitor.view = Viewpoint(message.view)

    def _orbit(self, message: said.OrbitCamera, visitor: Client) -> None:
        view = visitor.view.zoom_by(message.zoom)
        if view.name == "orbit":
            view = view.orbit_by(-message.dx * _ORBIT_RAD_PX, message.dy * _ORBIT_RAD_PX)
        elif visitor.viewport is not None:
            view = view.pan_by((message.dx, message.dy), self._posters.camera(visitor), 0.0)
        visitor.view = view

    def _stop(self, _message: said.Stop, visitor: Client) -> None:
        _check_may_control(visitor)
        self._gestures.reset()
        self._pilot.post(replace(self._pilot.command, live=False, goal=None))
        self._pilot.request_stop(_STOPPED)

    def _acknowledge(self, _message: said.Acknowledge, visitor: Client) -> None:
        _check_may_control(visitor)
        self._gestures.reset()
        self._pilot.acknowledge()

    def _take(self, message: said.TakeControl, visitor: Client) -> None:
        _check_may_control(visitor)
        if message.on and self._lease.holder != visitor.number:
            self._grant_control(visitor.number)
        elif not message.on and self._lease.release(visitor.number):
            self._stop_session()

    # --- what the one in control wants ---

    def _receive_in_control(self, message: Message, visitor: Client) -> None:
        """Turn what only the visitor in control may say into the arm's goal or mode."""
        self._require_control(visitor)
        self._update_after_session()
        self._pilot.post(replace(self._pilot.command, heartbeat_s=self._clock.now_s()))
        handle = self._control_handlers.get(type(message), self._gesture)
        try:
            handle(message, visitor)
        except IkservoError as error:
            raise BadMessageError(error.message, error.command_hint) from error
        self._send_setpoint()

    def _choose_speed(self, message: said.SetSpeed, _visitor: Client) -> None:
        self._pilot.post(replace(self._pilot.command, speed=message.name))

    def _choose_solver(self, message: said.SetSolver, _visitor: Client) -> None:
        self._gestures.choose_solver(message.name)

    def _prefer(self, message: said.PreferPosture, _visitor: Client) -> None:
        wanted = PosturePreference(message.pose, message.weights)
        self._gestures.set_preference(wanted, self._pilot.readout.measured)

    def _pose(self, message: said.GoToPose, _visitor: Client) -> None:
        self._gestures.pose(message.name, self._pilot.readout.measured)

    def _gesture(self, message: Any, visitor: Client) -> None:  # noqa: ANN401
        """Hear every other message: what a pointer, a key or a stick does in the drawing."""
        readout = self._pilot.readout
        if visitor.viewport is None or readout.trouble is not None:
            return
        camera, plane_m = self._posters.camera(visitor), self._posters.plane_m(visitor)
        sight = self._gestures.sight(camera, readout, plane_m)
        self._gestures.handle(message, sight, readout, self._clock.now_s())

    def _switch_live(self, message: said.SetLive, _visitor: Client) -> None:
        """Throw Live: the arm starts from where it stands, whatever the preview showed."""
        pilot, on = self._pilot, message.on
        if on and (pilot.readout.trouble or pilot.readout.talk):
            raise BadMessageError("The arm was stopped.", "Check it, then acknowledge.")
        self._gestures.reset()
        flight = (
            pilot.command.session_id + 1
            if on and not pilot.command.live
            else pilot.command.session_id
        )
        pilot.post(replace(pilot.command, live=on, goal=None, session_id=flight))

    def _handle_calibration(self, message: said.CalibrationAnswer, _visitor: Client) -> None:
        ritual = self._pilot.calibration
        if ritual is None or (self._pilot.command.live and message.word == "begin"):
            raise BadMessageError("The arm cannot be calibrated now.", "Switch Live off first.")
        if message.word == "begin":
            ritual.request_start()
        else:
            ritual.put_answer(f"{message.word} {message.joint or ''}".strip())

    def _update_after_session(self) -> None:
        """Notice that a flight has ended; what it went for is forgotten with it."""
        if self._pilot.arm is not self._arm:
            self._reset_for_arm()
        wish, readout = self._pilot.command, self._pilot.readout
        if wish.live and readout.ended_session >= wish.session_id:
            self._stop_session()

    def _reset_for_arm(self) -> None:
        """Begin anew with an arm that was opened again: its limits may be others."""
        self._arm = self._pilot.arm
        self._posters.close()
        self._gestures = Interaction(self._arm)
        self._posters = FrameComposer(self._pilot, self._gestures, self._clock)

    def _grant_control(self, visitor: int) -> None:
        """Give control to a visitor, who begins slowly and with a preview."""
        self._lease.acquire(visitor)
        self._stop_session()
        self._pilot.post(replace(self._pilot.command, speed="slow"))

    def _stop_session(self) -> None:
        self._gestures.reset()
        self._pilot.post(replace(self._pilot.command, live=False, goal=None))

    def _send_setpoint(self) -> None:
        wish = self._pilot.command
        goal = self._gestures.goal
        if wish.live and goal is not wish.goal:
            self._pilot.post(replace(wish, goal=goal))

    def _require_control(self, visitor: Client) -> None:
        _check_may_control(visitor)
        if visitor.number != self._lease.holder:
            raise BadMessageError("Another page is in control.", "Take control first.")


def _check_may_control(visitor: Client) -> None:
    if visitor.right is not Permission.CONTROL:
        raise BadMessageError(
            "This page is for watching only.", "Open the address with the other key."
        )
