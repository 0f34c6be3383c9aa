"""The session controller: permissions of clients, and the effects of their messages."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, get_args

import numpy as np

from ikservo.apps.page.dragging.drag_solver import PosturePreference
from ikservo.apps.page.dragging.goal_planning import GoalPlanner, PlanRequest
from ikservo.apps.page.dragging.interaction import Interaction
from ikservo.apps.page.dragging.labels import STOP_TEXTS
from ikservo.apps.page.dragging.snapshot import StopNotice
from ikservo.apps.page.messages import page_messages as msg
from ikservo.apps.page.messages.page_messages import BadMessageError, Message
from ikservo.apps.page.messages.program_messages import ProgramMessage, ShowStep
from ikservo.apps.page.messages.thing_messages import SaveThings, ThingMessage
from ikservo.apps.page.page_updates import FrameComposer
from ikservo.apps.page.panels.app_panels import AppPanels
from ikservo.apps.page.panels.camera_view import CameraView
from ikservo.apps.page.panels.episode_panel import EpisodePanel
from ikservo.apps.page.panels.follow_panel import FindArm, FollowPanel
from ikservo.apps.page.panels.live_plots import PlotFeed
from ikservo.apps.page.panels.motion_offer import HEADING, MotionOffer
from ikservo.apps.page.panels.page_cameras import ArmCameras
from ikservo.apps.page.panels.program_panel import ProgramPanel
from ikservo.apps.page.panels.servo_panel import ServoPanel
from ikservo.apps.page.panels.things_panel import AddOtherArm, ThingsPanel
from ikservo.apps.page.picking.lens_camera import LensCamera
from ikservo.apps.page.picking.projection import Viewport
from ikservo.apps.page.picking.viewpoints import Viewpoint, available_views
from ikservo.apps.page.running.arm_job import ExecutePath, RelaxArm, ReleaseArm, SetTipZero
from ikservo.apps.page.running.arm_thread import ArmThread
from ikservo.apps.page.running.history import csv_lines
from ikservo.apps.page.server.auth import Permission
from ikservo.apps.page.server.downloads import Download, DownloadOffers
from ikservo.apps.page.server.message_age_and_rate import Client
from ikservo.apps.page.server.server import Frame
from ikservo.arm import StopKind, StopReason
from ikservo.clock import Clock
from ikservo.errors import IkservoError

_ORBIT_RAD_PX = 0.008
_AWAY_TEXT = "Stopped: the page in control was hidden, closed or replaced."
_HARMLESS = ("up", "cancel", "hover", "leave")  # pointer events without a new target
_MAX_SILENCE_S = 2.5  # of the page, while it offers a grasp
_GO_LIVE_TEXT = "The arm no longer follows. The last goal was dropped."

Handler = Callable[[Any, Client], None]
"""Handler for one type of message."""


class SessionController:
    """Handler of the messages from all clients; one client controls the arm (``SessionBackend``).

    Runs in the server's thread; commands and snapshots of the arm thread are replaced as a whole.

    Attributes:
        downloads: The files that pages have requested.
    """

    def __init__(
        self,
        arm_thread: ArmThread,
        clock: Clock,
        downloads: DownloadOffers | None = None,
        find_arm: FindArm = lambda _: None,
        cameras: ArmCameras | None = None,
        add_other_arm: AddOtherArm = lambda _: None,
        episodes: EpisodePanel | None = None,
    ) -> None:
        self._arm_thread, self._clock = arm_thread, clock
        self._cameras = cameras
        self._fallback: StopNotice | None = None  # the reason why Live has ended
        self._plots, self.downloads = PlotFeed(), downloads or DownloadOffers(clock)
        self._lease = arm_thread.lease
        self._program = ProgramPanel(arm_thread)
        self._following = FollowPanel(arm_thread, clock, find_arm)
        self._app_panels = AppPanels(arm_thread, clock)
        self._servos, self._episodes = ServoPanel(arm_thread), episodes
        self._find_arm, self._add_other_arm = find_arm, add_other_arm
        self._show_arm()
        self._clients: dict[int, Client] = {}
        self._hand_stamp: tuple[float, float] | None = None  # its time of the page, and of this one
        self._numbers = itertools.count(1)
        # Only the client in control may send these; the pointer's messages are not in the table.
        self._control_handlers: dict[type, Handler] = {
            msg.SetLive: self._set_live,
            msg.CalibrationAnswer: self._handle_calibration,
            msg.GoToPose: self._set_target,
            msg.SetJoint: self._set_target,
            msg.JogJoint: self._set_target,
            msg.SetTool: self._set_target,
            msg.JogTool: self._set_target,
            msg.PointTool: self._set_target,
            msg.Undo: self._set_target,
            msg.SetTorque: self._set_torque,
            msg.ArmAction: self._start_action,
            msg.MarkTip: self._mark_tip,
            msg.Grasp: self._choose_grasp,
            msg.RunPanelMotion: self._run_panel_motion,
            msg.TrackHand: self._track_hand,
            msg.RecordEpisode: self._record_episode,
            msg.ChooseCamera: self._choose_camera,
            ShowStep: self._show_step,
            **dict.fromkeys(get_args(ThingMessage), self._handle_thing),
        }

    def close(self) -> None:
        """Cancel the background computations."""
        self._composer.close()
        self._planner.close()
        if self._camera_view is not None:
            self._camera_view.close()

    # --- connections ---

    def connect(self, permission: Permission) -> int:
        """Register a client and return its number; the first with permission gets control."""
        number = next(self._numbers)
        view = Viewpoint(available_views(self._composer.extent)[0])
        client = self._clients[number] = Client(number, permission, view)
        if permission is Permission.CONTROL and self._lease.holder is None:
            self._grant_control(client)
        return number

    def disconnect(self, client_id: int) -> None:
        """Remove a client; if it had control, the arm holds."""
        client = self._clients.pop(client_id)
        self._plots.forget(client_id)
        if self._lease.release(client.lease):
            self._stop_session()

    def frames(self, client_id: int) -> list[Frame]:
        """Return the new frames for a client."""
        self._update_after_session()
        self._offer.request(self._circumstances())
        client = self._clients[client_id]
        in_control = self._lease.is_held_by(client.lease)
        watches = in_control or self._composer.camera_view(client) is not None
        if watches and self._camera_view is not None:
            self._camera_view.watch(self._arm_thread.snapshot.measured)
        if in_control:
            self._interaction.continue_target(self._arm_thread.snapshot, self._clock.now_s())
            self._send_setpoint()
            self._update_path()
        others = "none" if self._lease.holder is None else "other"
        controller = "you" if in_control else others
        frames = self._composer.compose(client, controller=controller, fallback=self._fallback)
        frames += self._things.frames(client, self._offer.blocks)
        frames += self._program.frames(client)
        frames += self._following.frames(client)
        frames += self._app_panels.frames(client, self._offer.panels())
        frames += self._servos.frames(client)
        frames += [] if self._episodes is None else self._episodes.frames(client)
        frames += self._hand_frames() if in_control else []
        frames += self._plots.frames(client_id, self._arm_thread.history, self._clock.now_s())
        return frames + client.take_outbox()

    def stop(self, by: str) -> None:
        """Brake and hold until acknowledged; ``by`` is the subject of the notice to the user."""
        self._forget_targets()
        self._arm_thread.post(replace(self._arm_thread.command, live=False, goal=None))
        self._arm_thread.request_stop(StopReason(StopKind.CLIENT, f"{by}."))

    # --- messages of any client ---

    def receive(self, client_id: int, message: Message) -> None:
        """Handle a client's message.

        Raises:
            BadMessageError: The request is not permitted, or impossible now; nothing has changed.
        """
        client = self._clients[client_id]
        match message:
            case msg.Heartbeat():
                self._refresh_heartbeat(message, client)
            case msg.SetViewport():
                self._set_viewport(message, client)
            case msg.OrbitCamera():
                self._orbit_camera(message, client)
            case msg.FitView():
                client.view = Viewpoint(client.view.name)
            case msg.Stop():
                self.stop(STOP_TEXTS[message.by])
            case msg.Acknowledge():
                _check_may_control(client)
                self._interaction.reset()
                self._arm_thread.acknowledge()
            case msg.TakeControl():
                self._take_control(message, client)
            case msg.ShowPlots():
                self._plots.choose(client.number, message, self._arm_thread.history)
            case msg.SaveHistory():
                self._save_history(message, client)
            case SaveThings():
                client.outbox.append(self._things.offer())
            case _:
                self._receive_in_control(message, client)

    def _refresh_heartbeat(self, message: msg.Heartbeat, client: Client) -> None:
        if not self._lease.is_held_by(client.lease):
            return
        if message.visible:
            self._lease.refresh(client.lease)
            return
        if self._arm_thread.command.live:
            self._fallback = StopNotice("Live ended: the page was hidden.", _GO_LIVE_TEXT)
        self._stop_session()

    def _set_viewport(self, message: msg.SetViewport, client: Client) -> None:
        if message.view not in self._composer.views:
            raise BadMessageError(f"This arm has no view {message.view}.")
        client.viewport = Viewport(message.w, message.h, message.dpr)
        client.webgl = message.webgl and message.view == "orbit"
        client.handles, client.height_m = message.handles, message.height_m
        if message.view != client.view.name:
            client.view = Viewpoint(message.view)

    def _orbit_camera(self, message: msg.OrbitCamera, client: Client) -> None:
        if client.view.name == "camera":
            return  # the camera of a picture is fixed
        if message.zoom != 1.0:
            client.view = self._zoom_view(message, client)
        view = client.view
        if view.name == "orbit":
            view = view.orbit_by(-message.dx * _ORBIT_RAD_PX, message.dy * _ORBIT_RAD_PX)
        elif client.viewport is not None:
            view = view.pan_by((message.dx, message.dy), self._composer.camera(client), 0.0)
        client.view = view

    def _zoom_view(self, message: msg.OrbitCamera, client: Client) -> Viewpoint:
        """Return a client's view, zoomed about a pixel."""
        zoomed = client.view.zoom_by(message.zoom)
        if message.at is None or client.viewport is None:
            return zoomed
        extent = self._composer.extent
        before, after = (
            self._composer.camera(replace(client, view=view)) for view in (client.view, zoomed)
        )
        centre_depth_m = before.depth_of(extent.box_m.mean(axis=0))
        place_m = before.unproject(np.array(message.at), centre_depth_m)
        px, depth_m = after.project(place_m)
        dx, dy = (np.array(message.at) - px).tolist()
        return zoomed.pan_by((dx, dy), after, float(depth_m))

    def _take_control(self, message: msg.TakeControl, client: Client) -> None:
        _check_may_control(client)
        if message.on and not self._lease.is_held_by(client.lease):
            self._grant_control(client)
        elif not message.on and self._lease.release(client.lease):
            self._stop_session()

    def _save_history(self, message: msg.SaveHistory, client: Client) -> None:
        """Offer the history as a file."""
        history = self._arm_thread.history
        recording = history.last_stop if message.stopped else history.since(-math.inf)
        if recording is None:
            raise BadMessageError(
                "Nothing has stopped the arm yet.", "Save the recent history instead."
            )
        name = f"{self._arm.model.name}-{'stop' if message.stopped else 'history'}.csv"
        url = self.downloads.offer(Download(name, lambda: csv_lines(recording)))
        client.outbox.append({"kind": "download", "url": url, "name": name})

    # --- messages of the client in control ---

    def _receive_in_control(self, message: Message, client: Client) -> None:
        """Handle a message that only the client in control may send; it counts as a heartbeat."""
        _check_may_control(client)
        if not self._lease.is_held_by(client.lease):
            if isinstance(message, msg.TrackHand) and message.held:
                self._interaction.hand.spend(message.clutch)
            raise BadMessageError("Another page is in control.", "Take control first.")
        self._update_after_session()
        self._lease.refresh(client.lease)
        try:
            match message:
                case msg.SetSpeed():
                    self._arm_thread.post(replace(self._arm_thread.command, speed=message.name))
                case msg.SetSolver():
                    self._interaction.choose_solver(message.name)
                case msg.PreferPosture():
                    preference = PosturePreference(message.pose, message.weights)
                    self._interaction.set_preference(preference, self._arm_thread.snapshot.measured)
                case msg.ReadServo():
                    self._servos.read(message.joint)
                case msg.WriteRegister():
                    self._servos.write(message.joint, message.name, message.value)
                case msg.FollowArm(leader=None):
                    self._following.finish()
                case msg.FollowArm(leader=str(leader)):
                    self._require_ready()
                    self._following.start(leader)
                    self._interaction.reset()
                case _ if isinstance(message, ProgramMessage):
                    self._program.handle(message, self._interaction)
                    self._offer.drop_step()
                case _:
                    self._control_handlers.get(type(message), self._handle_input)(message, client)
        except IkservoError as error:
            raise BadMessageError(error.message, error.command_hint) from error
        self._send_setpoint()
        self._offer.request(self._circumstances())  # the message may have withdrawn it

    def _set_target(self, message: Any, _client: Client) -> None:  # noqa: ANN401
        """Set a pose, a previous goal, or a position or step of a joint or the tool."""
        snapshot, interaction = self._arm_thread.snapshot, self._interaction
        self._require_ready()
        match message:
            case msg.GoToPose():
                interaction.pose(message.name, snapshot)
            case msg.Undo():
                change = interaction.redo if message.redo else interaction.undo
                change(snapshot)
            case msg.SetJoint():
                interaction.set_joint(message.joint, message.value, snapshot)
            case msg.JogJoint():
                interaction.jog_joint(message.joint, message.step, snapshot)
            case msg.SetTool():
                interaction.set_tool(message.what, message.value, snapshot, step=False)
            case msg.JogTool():
                interaction.set_tool(message.what, message.step, snapshot, step=True)
            case _:
                interaction.point_tool(np.array(message.direction), snapshot)

    def _handle_thing(self, message: ThingMessage, _client: Client) -> None:
        """Change the things around the arm."""
        self._require_ready()
        self._refuse_in_live("Things cannot be changed while the arm follows.")
        self._things.handle(message, self._arm_thread.snapshot.measured)
        self._interaction.set_things(self._arm.scene.things)

    def _move_thing(self) -> None:
        """Show a thing at the place to which it is dragged; put it there once it is dropped."""
        moved = self._interaction.moved_thing
        if moved is None or not moved.shift_m.any():
            self._things.show_moved(None)
            return
        if self._arm_thread.command.live:
            self._interaction.reset()
        self._refuse_in_live("Things cannot be changed while the arm follows.")
        self._things.show_moved(moved)
        if moved.is_dropped:
            try:
                self._things.drop(moved)
            finally:
                self._interaction.set_things(self._arm.scene.things)

    def _set_torque(self, message: msg.SetTorque, _client: Client) -> None:
        """Switch a servo's torque; drop the goal, because the start of its plan may change."""
        self._require_ready()
        self._refuse_in_live("Torque stays on while Live is on.")
        self._arm.joint_index.column(message.joint)
        self._interaction.reset()
        self._arm_thread.request_torque(message.joint, on=message.on)

    def _start_action(self, message: msg.ArmAction, client: Client) -> None:
        """Move the arm to the target of the preview, relax it, or switch its torque off."""
        self._require_ready()
        if message.action == "release":
            self._interaction.reset()
            self._arm_thread.request_job(ReleaseArm())
            return
        self._arm.context.require_zeros()
        if message.action == "relax":
            self._interaction.reset()
            self._arm_thread.request_job(RelaxArm())
            return
        picture = self._composer.camera_view(client)
        if picture is not None:
            picture.require_usable()
        self._interaction.finish_target()
        request, path = self._plan_request(), self._planner.path
        if request is None:
            raise BadMessageError("No target is shown.", "Drag the arm or click a point first.")
        if path is None or path.number != message.path:
            raise BadMessageError("The path to that target is not shown yet.", "Nothing moved.")
        path.plan_for(request)
        self._arm_thread.request_job(ExecutePath(path))
        self._offer.drop()

    def _mark_tip(self, message: msg.MarkTip, client: Client) -> None:
        """Set the zero that a click on the tip determines."""
        self._require_ready()
        picture, camera = self._composer.camera_view(client), self._composer.camera(client)
        if picture is None or not isinstance(camera, LensCamera):
            raise BadMessageError(
                "This needs a click in a camera's picture.", "Choose the camera view."
            )
        px, snapshot = np.array([message.x, message.y]), self._arm_thread.snapshot
        found = picture.find_tip_zero(camera, px, snapshot)
        self._arm_thread.request_job(SetTipZero(found))

    def _choose_grasp(self, message: msg.Grasp | msg.RunPanelMotion, client: Client) -> None:
        """Look for blocks, choose a block to pick up, or choose a place for the held thing."""
        self._require_ready()
        if self._camera_view is None:
            raise BadMessageError("This needs a calibrated camera that sees the blocks.")
        self._arm.context.require_zeros()
        self._refuse_in_live("Nothing can be picked up while Live is on.")
        self._offer.request(self._circumstances())
        self._interaction.reset()
        camera = self._composer.camera(client)
        self._offer.choose(message, self._camera_view, camera, self._circumstances())

    def _show_step(self, message: ShowStep, _client: Client) -> None:
        """Offer the motion of a step of the program from the arm's position, or nothing."""
        self._offer.drop()
        motion = None if message.step is None else self._program.motion_of(message.step)
        if motion is not None:
            self._require_ready()
            self._refuse_in_live("The motion of a step is shown while Live is off.")
            self._arm.context.require_zeros()
            self._interaction.reset()
            self._offer.choose_step(motion, self._circumstances())

    def _run_panel_motion(self, message: msg.RunPanelMotion, client: Client) -> None:
        if message.heading == HEADING:
            self._choose_grasp(message, client)
            return
        self._require_ready()
        self._app_panels.start(message.heading, message.button)
        self._interaction.reset()

    def _record_episode(self, message: msg.RecordEpisode, _client: Client) -> None:
        if self._episodes is None:
            raise BadMessageError(
                "This page does not record.", "Start it with: ikservo view ARM --record FOLDER"
            )
        self._episodes.handle(message)

    def _circumstances(self) -> tuple[object, ...]:
        """Return the values that withdraw the offer of a grasp if any of them changes."""
        snapshot, scene, view = self._arm_thread.snapshot, self._arm.scene, self._camera_view
        stops = self._arm.context.servos.stop_request.count
        torque = [state.torque for state in snapshot.states]
        around = scene.things, scene.held, scene.arms, view, view and view.change
        is_silent = self._lease.silence_s() > _MAX_SILENCE_S
        targets = self._interaction.goal is None, self._interaction.resets
        return self._arm_thread.job, stops, snapshot.stop_notice, torque, around, is_silent, targets

    def _choose_camera(self, message: msg.ChooseCamera, _client: Client) -> None:
        """Show another camera; clients whose view no longer exists see the first view."""
        if self._cameras is None:
            raise BadMessageError("This arm has no camera.")
        self._cameras.choose(message.camera)
        if self._camera_view is not None:
            self._camera_view.close()
        self._camera_view = self._find_camera_view()
        self._composer.show_camera(self._camera_view)
        for client in self._clients.values():
            client.sent.pop("arm_info", None)
            if client.view.name not in self._composer.views:
                client.view = Viewpoint(self._composer.views[0])

    def _require_ready(self) -> None:
        """Raise if the arm accepts no targets."""
        snapshot, job = self._arm_thread.snapshot, self._arm_thread.job
        if snapshot.calibration:
            raise BadMessageError(
                "The arm is being calibrated.", "Finish or cancel the calibration first."
            )
        if snapshot.stop_notice:
            raise BadMessageError("The arm was stopped.", "Check it, then acknowledge.")
        if job is not None:
            raise BadMessageError(
                f"The arm is busy: {job.title}.", "Wait until it has ended, or stop it."
            )

    def _refuse_in_live(self, reason: str) -> None:
        if self._arm_thread.command.live:
            raise BadMessageError(reason, "Switch Live off first.")

    def _handle_input(self, message: Any, client: Client) -> None:  # noqa: ANN401
        """Handle pointer, wheel, key and gamepad messages; report a press that has no effect."""
        snapshot = self._arm_thread.snapshot
        if client.viewport is None:
            return
        if isinstance(message, msg.Wheel | msg.Key) or getattr(message, "phase", "") == "down":
            self._require_ready()
        elif snapshot.stop_notice is not None or self._arm_thread.job is not None:
            return
        picture = self._composer.camera_view(client)
        if picture is not None and getattr(message, "phase", "") not in _HARMLESS:
            picture.require_usable()
        surface = None if picture is None else picture.surface(client.height_m)
        camera, plane_m = self._composer.camera(client), self._composer.plane_m(client)
        context = self._interaction.pointer_context(camera, snapshot, plane_m, surface)
        self._interaction.handle(message, context, snapshot, self._clock.now_s())
        self._move_thing()

    def _track_hand(self, message: msg.TrackHand, _client: Client) -> None:
        """Move the goal with the hand; an arm that accepts no targets opens the clutch."""
        arm_thread, snapshot = self._arm_thread, self._arm_thread.snapshot
        if snapshot.stop_notice or snapshot.calibration or arm_thread.job is not None:
            self._interaction.hand.refuse(message)
        else:
            self._arm.context.require_zeros()
            speed = arm_thread.command.speed
            self._interaction.track_hand(message, snapshot, speed, self._clock.now_s())
        self._hand_stamp = message.stamp, self._clock.now_s()

    def _hand_frames(self) -> list[Frame]:
        """Return the limit of the hand's motion, once the arm was read after the last pose."""
        if self._hand_stamp is None or self._arm_thread.snapshot.read_s <= self._hand_stamp[1]:
            return []
        (stamp, _), self._hand_stamp = self._hand_stamp, None
        hand, refusal = self._interaction.hand, self._interaction.refusal
        limit = hand.limit if refusal is None or not hand.is_held else refusal.reason
        return [{"kind": "hand", "stamp": stamp, "held": hand.is_held, "limit": limit}]

    def _set_live(self, message: msg.SetLive, _client: Client) -> None:
        """Switch Live; the arm starts at its measured position, not at the goal of the preview."""
        arm_thread, on = self._arm_thread, message.on
        if on:
            self._require_ready()
            arm_thread.arm.context.require_zeros()
        self._fallback = None
        self._forget_targets()
        session_id = arm_thread.command.session_id + (on and not arm_thread.command.live)
        arm_thread.post(replace(arm_thread.command, live=on, goal=None, session_id=session_id))

    def _handle_calibration(self, message: msg.CalibrationAnswer, _client: Client) -> None:
        driver = self._arm_thread.calibration
        busy = self._arm_thread.command.live or self._arm_thread.job is not None
        if driver is None or (busy and message.action == "start"):
            raise BadMessageError("The arm cannot be calibrated now.", "Switch Live off first.")
        if message.action == "start":
            self._forget_targets()
            driver.request_start()
        else:
            driver.put_answer(f"{message.action} {message.joint or ''}".strip(), message.number)

    def _update_after_session(self) -> None:
        """Use the new ``Arm`` after a reopening, and reset the goal if the session has ended."""
        if self._arm_thread.arm is not self._arm:  # its limits may have changed
            self.close()
            self._interaction.hand.release()
            spent = self._interaction.hand.spent
            self._show_arm()
            self._interaction.hand.spent = spent
        command, snapshot = self._arm_thread.command, self._arm_thread.snapshot
        if command.live and snapshot.ended_session >= command.session_id:
            if not snapshot.stop_notice:
                self._fallback = StopNotice("Live ended: the page did not answer.", _GO_LIVE_TEXT)
            self._stop_session()

    def _show_arm(self) -> None:
        """Make everything that refers to the open arm."""
        arm = self._arm = self._arm_thread.arm
        self._interaction = Interaction(arm, self._clock)
        self._planner, self._offer = GoalPlanner(arm), MotionOffer(self._arm_thread)
        self._things = ThingsPanel(arm, self.downloads, self._find_arm, self._add_other_arm)
        self._camera_view = self._find_camera_view()
        self._composer = FrameComposer(
            self._arm_thread, self._interaction, self._clock, self._camera_view
        )

    def _find_camera_view(self) -> CameraView | None:
        """Find the view of the arm's camera; if there is none, report why clicks have no effect."""
        cameras = self._cameras
        if cameras is None or cameras.video is None:
            return None
        try:
            return CameraView(self._arm, cameras.video, self._clock, cameras.name)
        except IkservoError as error:
            text = f"Clicks in the picture cannot set targets: {error.message} {error.command_hint}"
            self._interaction.log(text.rstrip())
            return None

    @property
    def is_camera_calibrated(self) -> bool:
        """Whether the shown camera was calibrated with the arm."""
        return self._camera_view is not None

    def _forget_targets(self) -> None:
        """Drop the goal and all previous goals; the arm holds."""
        self._interaction.reset()
        self._interaction.history.clear()

    def _grant_control(self, client: Client) -> None:
        """Give control to a client, which starts at slow speed in the preview."""
        client.lease = self._lease.acquire(f"page {client.number}", take_over=True).lease
        self._fallback = None
        self._stop_session()
        self._arm_thread.post(replace(self._arm_thread.command, speed="slow"))

    def _stop_session(self) -> None:
        if self._arm_thread.moves_itself:
            self._arm_thread.request_stop(StopReason(StopKind.CLIENT, _AWAY_TEXT))
        self._interaction.reset()
        self._planner.update(None, self._clock.now_s())
        self._arm_thread.post(replace(self._arm_thread.command, live=False, goal=None))

    def _update_path(self) -> None:
        """Plan the path to the preview's goal; in Live, report a goal that the guard refuses."""
        goal, now_s = self._interaction.goal, self._clock.now_s()
        if self._arm_thread.command.live:
            self._planner.update(None, now_s)
            refused = self._arm_thread.snapshot.refusal
            is_of_goal = refused is not None and refused.goal is goal
            self._interaction.show_path(None, refused if is_of_goal else None)
        elif not isinstance(self._arm_thread.job, ExecutePath) and (
            self._arm_thread.job is None or self._interaction.goal is None
        ):  # the path of a running motion stays visible
            self._planner.update(self._plan_request(), now_s)
            path = self._planner.path
            is_several = path is not None and path.run is not None
            if path and path.plan and not (is_several or self._interaction.is_choosing):
                self._interaction.take_posture(path.request.goal)
            self._interaction.show_path(path, None if path is None else path.refusal)

    def _plan_request(self) -> PlanRequest | None:
        """Return the path to plan now; None if there is no goal, or the arm is at the goal."""
        grasp = self._offer.request(self._circumstances())
        if grasp is not None:
            return grasp
        goal, snapshot = self._interaction.goal, self._arm_thread.snapshot
        is_idle = not (snapshot.stop_notice or snapshot.calibration)
        if goal is None or not is_idle or not self._arm.zeros.are_known:
            return None
        speed, is_chosen = self._arm_thread.command.speed, not self._interaction.is_choosing
        marker = self._interaction.marker
        request = PlanRequest(
            self._arm, goal, snapshot.start, speed, is_chosen=is_chosen, marker=marker
        )
        return None if request.is_reached else request

    def _send_setpoint(self) -> None:
        command = self._arm_thread.command
        goal = self._interaction.goal
        if command.live and goal is not command.goal:
            marker = self._interaction.marker
            by_tip = marker is not None and marker.frame is None
            self._arm_thread.post(replace(command, goal=goal, by_tip=by_tip))


def _check_may_control(client: Client) -> None:
    if client.permission is not Permission.CONTROL:
        raise BadMessageError("This page can only watch.", "Open the control address.")
