"""A page's session with the picture of a simulated camera, in virtual time, without a browser."""

import time
from concurrent.futures import wait
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from ikservo.apps.cameras.camera_sources import open_source
from ikservo.apps.page.message_handling import SessionController
from ikservo.apps.page.messages import page_messages as msg
from ikservo.apps.page.panels.motion_offer import HEADING
from ikservo.apps.page.running.arm_thread import ArmThread
from tests.apps.cameras.saved_camera import BOARD
from tests.apps.page.view_session import ViewSession
from tests.arm.simulated import clock_of

SOUGHT_S = 60.0  # real time for a search in another thread


@dataclass
class Pictures:
    """Pictures of a simulated camera (``VideoSource``); a test takes them."""

    newest: object
    source: str = "sim"
    is_fresh: bool = True
    before: object = None


class Cameras:
    """The cameras of a page, with only one (``ArmCameras``)."""

    def __init__(self, camera):
        self.camera, self.name = camera, ""
        self.video = Pictures(camera.take())

    def choose(self, _choice):
        """Show another camera, with the same pictures."""


class PickSession(ViewSession):
    """A client that views the picture; a test runs the arm's thread itself."""

    def __init__(self, arm):
        arm.enable()
        self.arm, self.clock = arm, clock_of(arm)
        camera = open_source("sim", arm.context.port.transport, BOARD)
        self.arm_thread = ArmThread(lambda: arm, self.clock)
        self.cameras = Cameras(camera)
        self.controller = SessionController(self.arm_thread, self.clock, cameras=self.cameras)
        self.goals, self.shown = [], {}
        self.client = self.connect()
        self.look()

    def connect(self, *right):
        client = self.controller.connect(*right) if right else super().connect()
        self.send_message(msg.SetViewport, client, w=960, h=720, dpr=1, view="camera")
        return client

    @property
    def offer(self):
        """The number of the shown plan of a pick or place; None if none is offered."""
        path = self.interaction.path
        is_offer = path is not None and path.plan is not None and path.run is not None
        return path.number if is_offer else None

    @property
    def panel(self):
        """The panel that describes the choice; None if nothing is chosen."""
        panels = self.shown.get("app_panels", {"panels": []})["panels"]
        return next((each for each in panels if each["heading"] == HEADING), None)

    @property
    def text(self):
        return "" if self.panel is None else self.panel["rows"][0][1]

    @property
    def holds(self):
        measured = self.arm_thread.snapshot.measured
        return self.arm.grip.is_held_at(self.arm.context, measured)

    def look(self):
        """Let the arm's thread run, then receive the frames; return all latest ones."""
        self.arm_thread.step()
        self.send_message(msg.Heartbeat, visible=True)
        self.shown |= self.latest_frames()
        return self.shown

    def until(self, true, what=""):
        """Look until a condition holds."""
        until_s = time.monotonic() + SOUGHT_S
        while not true():
            assert time.monotonic() < until_s, f"never: {what}; {self.text} {self.texts}"
            busy = self.controller._planner._busy
            wait([] if busy is None else [busy[2]], timeout=1.0)  # time stands still meanwhile
            self.look()
        return self

    def pixel(self, point_m):
        """Return the pixel of the drawing at which the page shows a point (3,)."""
        return tuple(self.camera().project(np.asarray(point_m))[0].tolist())

    def click(self, point_m):
        """Click a point (3,) for a grasp."""
        self.send_message(msg.Grasp, at=self.pixel(point_m))

    def offered(self, point_m):
        """Click a point (3,), wait for the offer and return its number."""
        return self.offered_at(self.pixel(point_m))

    def offered_at(self, px):
        """Click a pixel (2,), wait for the offer and return its number."""
        self.send_message(msg.Grasp, at=tuple(px))
        self.look()
        self.until(lambda: self.offer or self.interaction.refusal, "an offer")
        assert self.offer, self.interaction.refusal
        return self.offer

    def go(self, number):
        """Carry out an offer, and let the arm's thread run the job to its end."""
        self.send_message(msg.ArmAction, action="execute", path=number)
        on_progress = self.arm_thread.on_progress

        def answer(progress):
            self.send_message(msg.Heartbeat, visible=True)
            on_progress(progress)

        self.arm_thread.on_progress = answer
        self.arm_thread.step()
        self.arm_thread.on_progress = on_progress
        return self.look()

    @property
    def texts(self):
        return [each["message"] for each in self.shown["status"]["messages"]]


@contextmanager
def pick_session(arm):
    session = PickSession(arm)
    try:
        yield session
    finally:
        session.controller.close()
