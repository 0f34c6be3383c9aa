"""A click on the tip in the picture sets the zero that the board cannot show, or is refused."""

from types import SimpleNamespace

import numpy as np
import pytest

from ikservo.apps.page.message_handling import SessionController
from ikservo.apps.page.messages import page_messages
from ikservo.apps.page.messages import thing_messages as things
from ikservo.apps.page.running.arm_thread import ArmThread
from ikservo.apps.page.server.auth import Permission
from ikservo.arm.opening import open_own_arm
from ikservo.calibration.calibration_file import load_calibration
from tests.calibration.mounted_arms import load_model
from tests.cli.fixtures_mounted_arm import PORT, SERIAL

pytest.importorskip("cv2")

from tests.apps.cameras.mistaken_tip import ARM, JOINT, mistaken_tip, tip_pixel
from tests.apps.page.test_camera_view import Video
from tests.apps.page.view_session import ViewSession


class TipSession(ViewSession):
    """The page of an arm with a calibrated camera, in the view Camera."""

    def __init__(self, arm, camera):
        self.mounted, self.camera_before = arm, camera
        self.arm = open_own_arm(load_model(ARM), PORT)
        self.arm.enable()
        self.clock, self.video = self.arm.clock, Video(camera.take(), source="0")
        opened = iter([self.arm])
        self.arm_thread = ArmThread(
            lambda: next(opened, None) or open_own_arm(load_model(ARM), PORT), self.clock
        )
        cameras = SimpleNamespace(video=self.video, name="")
        self.controller = SessionController(self.arm_thread, self.clock, cameras=cameras)
        self.client = self.controller.connect(Permission.CONTROL)
        self.show("camera")
        self.rest()

    def show(self, view):
        self.send_message(page_messages.SetViewport, w=960, h=720, dpr=1, view=view)

    def rest(self):
        for _ in range(12):
            self.clock.sleep_until(self.clock.now_s() + 0.1)
            self.arm_thread.step()
            self.latest_frames()

    def mark(self, away_px=(0.0, 0.0)):
        u, v = np.add(tip_pixel(self.mounted, self.camera_before), away_px) + 0.5
        self.send_message(page_messages.MarkTip, x=float(u), y=float(v))

    def __exit__(self, *_):
        self.controller.close()
        self.arm_thread.arm.close()


@pytest.fixture
def session(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    with TipSession(*mistaken_tip(monkeypatch)) as session:
        yield session


def test_tip_click_on_page_reopens_arm_with_new_zero(session):
    scene = session.latest_frames()["scene"]
    assert (scene["tip_shows"], scene["tip_clicks"]) == (JOINT, 0)
    before = load_calibration(ARM, SERIAL)
    session.send_message(things.AddThing, shape="box")
    session.mark()
    session.arm_thread.step()
    arm = session.arm_thread.arm
    assert arm.scene.names == ("the box 1",)
    assert "the box 1" in arm.context.collision.things
    found = session.arm_thread.arm.where()[JOINT].position_rad
    assert found == pytest.approx(session.mounted.true_position(JOINT), abs=7e-3)
    assert load_calibration(ARM, SERIAL) != before
    messages = [entry.message for entry in session.arm_thread.snapshot.messages]
    said = next(message for message in messages if f"calibration undo {ARM}" in message)
    assert "according to 1 click; standard error" in said
    assert "click again" in said
    session.rest()
    assert session.latest_frames()["scene"]["tip_clicks"] == 1
    session.mark()  # nothing is left to be found
    session.arm_thread.step()
    assert not session.arm_thread.snapshot.stop_notice
    after = session.arm_thread.arm.where()[JOINT].position_rad
    assert after == pytest.approx(found, abs=2e-3)


def test_unusable_tip_click_changes_nothing(session):
    before = load_calibration(ARM, SERIAL)

    def refused(text, away_px=(0.0, 0.0)):
        with pytest.raises(page_messages.BadMessageError, match=text):
            session.mark(away_px)

    refused("or more from every position that the tip can reach", (90.0, -90.0))
    session.video.is_fresh = False
    refused("The camera picture is too old")
    session.video.is_fresh = True
    session.clock.sleep_until(session.clock.now_s() + 2.0)
    refused("The arm was not seen at rest yet")  # it was not read since
    session.mounted.world.place("joint1", session.mounted.true_position("joint1") + 0.02)
    session.arm_thread.step()
    refused("The arm was not seen at rest yet")
    session.show("side")
    refused("in a camera's picture")
    assert session.arm_thread.job is None
    assert load_calibration(ARM, SERIAL) == before
