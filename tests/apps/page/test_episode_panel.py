"""An episode ends if the arm or a camera fails, and is kept if it cannot be saved."""

import dataclasses
import time
from contextlib import ExitStack
from types import SimpleNamespace

import numpy as np
import pytest

import ikservo
from ikservo.apps.page.dragging.snapshot import ArmSnapshot, StopNotice
from ikservo.apps.page.messages.page_messages import RecordEpisode
from ikservo.apps.page.panels import episode_panel
from ikservo.apps.page.panels.episode_panel import EpisodeFolder, EpisodePanel
from ikservo.apps.page.panels.video import VideoSource
from ikservo.apps.page.picking.viewpoints import Viewpoint
from ikservo.apps.page.server.auth import Permission
from ikservo.apps.page.server.message_age_and_rate import Client
from ikservo.apps.teaching.dataset_reading import read_dataset
from ikservo.clock import RealClock
from ikservo.errors import InputError
from ikservo.files.writing import FileWriteError
from tests.apps.page.webcam import Webcam

CLOCK = RealClock()
WITHIN_S = 20.0


class Cameras:
    """The cameras of an arm: one that a test can unplug."""

    def __init__(self, webcam):
        self.video = VideoSource("0", CLOCK, webcam.open)

    def open_all(self):
        return {"camera 0": self.video}


class ReadArm:
    """The thread of an arm that was read just now, or ``late_s`` ago."""

    def __init__(self):
        model = ikservo.load_model("so101")
        joints, states = np.zeros(len(model.joints)), (SimpleNamespace(torque=True),)
        self.arm, self.late_s = SimpleNamespace(model=model), 0.0
        self.lease = SimpleNamespace(holder="a page", silence_s=lambda: 0.0)
        self.state = ArmSnapshot(joints, joints, states=states)

    @property
    def snapshot(self):
        at = CLOCK.now_s() - self.late_s
        return dataclasses.replace(
            self.state, read_s=at, measured=np.full_like(self.state.start, at)
        )

    def change(self, **fields):
        self.state = dataclasses.replace(self.state, **fields)


class Page:
    """A panel with an arm that is read at each look, and the exits that close it."""

    def __init__(self, folder, cameras=None):
        self.exits, self.folder = ExitStack(), folder
        self.thread = ReadArm()
        folder.mkdir()
        self.panel = EpisodePanel(
            self.thread, CLOCK, EpisodeFolder(folder, "wave"), cameras, self.exits
        )

    def send(self, action):
        self.panel.handle(RecordEpisode(kind="record_episode", seq=1, seen=0, action=action))

    def fields(self):
        page = Client(1, Permission.CONTROL, Viewpoint("side"))
        return self.panel.frames(page)[0]

    def until(self, state, seconds=0.0):
        end_s = time.monotonic() + WITHIN_S
        while self.fields()["state"] != state:
            assert time.monotonic() < end_s, self.fields()
            time.sleep(0.02)
        time.sleep(seconds)
        return self.fields()

    def record(self, seconds=0.3):
        self.send("begin")
        return self.until("recording", seconds)


@pytest.fixture
def page(tmp_path):
    return Page(tmp_path / "set")


@pytest.fixture
def webcam():
    return Webcam()


@pytest.fixture
def filmed(tmp_path, webcam):
    cameras = Cameras(webcam)
    with cameras.video:
        page = Page(tmp_path / "set", cameras)
        yield page
        page.panel._end_sampling()


def stop_the_arm(page):
    page.thread.change(stop_notice=StopNotice("Stopped.", ""))


def begin_a_calibration(page):
    page.thread.change(calibration=object())


def open_the_arm_again(page):
    page.thread.arm = SimpleNamespace(model=page.thread.arm.model)


def close_the_page(page):
    page.thread.lease.holder = None


def hide_the_page(page):
    page.thread.lease.silence_s = lambda: 3.0


def lose_the_arm(page):
    page.thread.late_s = 1.0


EVENTS = {
    stop_the_arm: "The arm is stopped.",
    begin_a_calibration: "calibrated or opened again",
    open_the_arm_again: "calibrated or opened again",
    close_the_page: "No page controls the arm.",
    hide_the_page: "No page controls the arm.",
    lose_the_arm: "The arm does not answer.",
}


@pytest.mark.parametrize(
    ("event", "text"), EVENTS.items(), ids=lambda e: getattr(e, "__name__", "")
)
def test_event_ends_an_episode_which_can_be_saved(page, event, text):
    page.record()
    event(page)
    assert text in page.until("ended")["text"]
    page.send("save")
    page.until("idle")
    assert len(read_dataset(page.folder).episodes) == 1


@pytest.mark.parametrize("event", [stop_the_arm, close_the_page, lose_the_arm])
def test_episode_of_an_arm_that_is_not_ready_does_not_begin(page, event):
    event(page)
    with pytest.raises(InputError, match="Nothing is recorded"):
        page.send("begin")
    assert page.fields()["state"] == "idle"


@pytest.mark.parametrize(
    "error", [ValueError("?"), FileWriteError("a", "No space left"), OSError(5)]
)
def test_episode_that_cannot_be_saved_is_kept(page, monkeypatch, error):
    page.record()

    def fail(*_):
        raise error

    with monkeypatch.context() as broken:
        broken.setattr(episode_panel.DatasetWriter, "add", fail)
        page.send("save")
        assert page.until("ended")["text"]
    page.send("save")
    assert page.until("idle")["episodes"] == 1


def test_closed_arm_saves_its_episode(page):
    page.record()
    page.exits.close()
    assert len(read_dataset(page.folder).episodes) == 1


def test_closed_arm_reports_an_episode_that_cannot_be_saved(page, monkeypatch):
    page.record()

    def fail(*_):
        raise FileWriteError(page.folder, "No space left")

    monkeypatch.setattr(episode_panel.DatasetWriter, "add", fail)
    with pytest.raises(FileWriteError):
        page.exits.close()


def test_discarded_episode_leaves_no_file(page):
    page.record()
    page.send("discard")
    assert page.fields()["state"] == "idle"
    page.exits.close()
    assert not list(page.folder.rglob("*.parquet"))


def saved_values(page):
    page.record()
    page.send("save")
    page.until("idle")
    return [read_dataset(page.folder, what).episodes[0].values for what in ("state", "action")]


def test_limp_arm_has_the_next_joints_as_its_action(page):
    page.thread.change(states=(SimpleNamespace(torque=False),))
    state, action = saved_values(page)
    np.testing.assert_allclose(action[:-1], state[1:])


def test_holding_arm_has_its_set_points_as_its_action(page):
    state, action = saved_values(page)
    assert np.ptp(state, axis=0).min() > 0.0
    assert np.ptp(action, axis=0).max() == 0.0


def test_camera_is_read_only_during_an_episode(filmed, webcam):
    time.sleep(0.2)
    assert webcam.opened == 0
    filmed.record(0.5)
    assert webcam.opened == 1
    filmed.send("save")
    filmed.until("idle")
    assert webcam.released == 1


def test_unplugged_camera_ends_the_episode(filmed, webcam):
    filmed.record(0.8)
    webcam.plugged = False
    assert "camera 0 was interrupted" in filmed.until("ended")["text"]
    filmed.send("save")
    assert filmed.until("idle")["episodes"] == 1


def test_camera_that_is_plugged_in_again_ends_the_episode(filmed, webcam):
    filmed.record(0.8)
    webcam.plugged = False
    time.sleep(0.1)
    webcam.plugged = True
    assert "interrupted" in filmed.until("ended")["text"]


def test_next_episode_begins_at_once_with_new_pictures(filmed, webcam):
    slow = webcam.release
    webcam.release = lambda: (time.sleep(0.3), slow())  # as a real camera
    for count in (1, 2):
        filmed.record()
        end_s = time.monotonic() + WITHIN_S
        while not filmed.panel._samples and time.monotonic() < end_s:
            time.sleep(0.02)  # until the camera is open again
        time.sleep(1.6)  # longer than until a camera is opened again
        assert filmed.fields()["state"] == "recording"
        filmed.send("save")
        assert filmed.until("idle")["episodes"] == count


def test_missing_camera_is_named_and_nothing_is_recorded(filmed, webcam, monkeypatch):
    monkeypatch.setattr(episode_panel, "_CAMERAS_S", 0.3)
    webcam.plugged = False
    filmed.send("begin")
    assert "camera 0" in filmed.until("ended")["text"]
    with pytest.raises(InputError, match="no frames"):
        filmed.send("save")
    filmed.send("discard")


def test_camera_that_changes_its_size_ends_the_episode(filmed, webcam):
    filmed.record(0.8)
    webcam.read = lambda: (time.sleep(0.01), (True, np.zeros((48, 64, 3), np.uint8)))[1]
    assert "changed their size" in filmed.until("ended")["text"]


def test_cameras_of_the_same_name_get_different_columns(tmp_path, webcam):
    cameras = Cameras(webcam)
    cameras.open_all = lambda: {"Left": cameras.video, "left": cameras.video}
    page = Page(tmp_path / "set", cameras)
    assert list(page.panel._videos) == ["left", "left_2"]
