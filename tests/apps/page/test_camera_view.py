"""When clicks in the picture of a calibrated camera are targets, and when they are refused."""

import time
from dataclasses import dataclass, field

import numpy as np
import pytest

import ikservo
from ikservo.apps.cameras.camera_file import SIMULATED, load_camera, save_camera
from ikservo.apps.page.messages.page_messages import BadMessageError
from ikservo.apps.page.panels.camera_view import CameraView
from ikservo.kinematics.se3 import log_so3
from tests.guard.gates import ManualClock

pytest.importorskip("cv2")

from tests.apps.cameras.saved_camera import save_simulated_camera


@dataclass
class Video:
    newest: np.ndarray | None
    is_fresh: bool = True
    source: str = field(default="sim")
    before: object = None


@pytest.fixture
def arm(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    with ikservo.open_arm("so101", "sim:?pose=home") as arm:
        yield arm


@pytest.fixture
def camera(arm):
    return save_simulated_camera(arm)


def look(view, clock, measured):
    """Let a view take and judge one picture."""
    for _ in range(2):
        clock.time_s += 2.0
        view.watch(measured)
    until_s = time.monotonic() + 20.0
    while view._checking is not None and time.monotonic() < until_s:
        time.sleep(0.01)
        view.watch(measured)


def measured_joints(arm):
    here = arm.where()
    return np.array([here[name].position_rad for name in arm.joint_names])


@pytest.mark.full
def test_click_in_mirrored_camera_picture_is_refused(arm, camera):
    clock, picture, q = ManualClock(), camera.take(), measured_joints(arm)
    view = CameraView(arm, video := Video(picture), clock)
    look(view, clock, q)
    view.require_usable()
    video.newest = np.ascontiguousarray(picture[:, ::-1])
    look(view, clock, q)
    with pytest.raises(BadMessageError, match="The picture is mirrored"):
        view.require_usable()
    video.newest = picture
    look(view, clock, q)
    view.require_usable()
    view.close()


def test_click_in_outdated_or_resized_camera_picture_is_refused(arm, camera):
    view = CameraView(arm, video := Video(camera.take(), is_fresh=False), ManualClock())
    with pytest.raises(BadMessageError, match="too old"):
        view.require_usable()
    video.newest, video.is_fresh = np.zeros((480, 640, 3), np.uint8), True
    with pytest.raises(BadMessageError, match="640 x 480 pixels, not 960 x 720"):
        view.require_usable()
    view.close()


def test_click_in_picture_of_another_simulated_arm_is_refused(arm, camera):
    view = CameraView(arm, video := Video(camera.take()), ManualClock())
    video.before = arm.context.port.transport
    view.require_usable()
    video.before = object()
    with pytest.raises(BadMessageError, match="shows another simulated arm"):
        view.require_usable()
    view.close()


def test_camera_facing_away_from_board_counts_as_moved(arm, camera):
    _, known = load_camera("so101", SIMULATED)
    T = camera.T_base_camera
    back = np.degrees(log_so3(T[:3, :3] * [1.0, -1.0, -1.0]))
    at = 1000.0 * (T[:3, 3] + 0.05 * T[:3, 0])
    turned = known.camera.model_copy(update={"turned_deg": tuple(back), "at_mm": tuple(at)})
    save_camera("so101", SIMULATED, known.model_copy(update={"camera": turned}))
    clock = ManualClock()
    view = CameraView(arm, Video(camera.take()), clock)
    for _ in range(2):
        look(view, clock, measured_joints(arm))
    with pytest.raises(BadMessageError, match="has moved"):
        view.require_usable()
    view.close()
