"""An arm stops moving if the camera of its calibration fails."""

import itertools

import numpy as np
import pytest

from ikservo.arm.opening import open_own_arm
from ikservo.errors import CalibrationError
from tests.calibration.mounted_arms import load_model
from tests.cli.fixtures_mounted_arm import PORT

cv2 = pytest.importorskip("cv2")

from ikservo.apps.cameras.camera_calibration import CameraCalibration  # noqa: E402
from tests.apps.cameras.hidden_arms import BOARD, finish, hidden_arm  # noqa: E402


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))


class SpoiledCamera:
    """A camera that fails after some pictures."""

    def __init__(self, camera, good, spoil):
        self._camera, self._good, self._spoil = camera, good, spoil

    def take(self):
        self._good -= 1
        picture = self._camera.take()
        return picture if self._good >= 0 else self._spoil(picture)


def hunt():
    """Return a function that brightens and darkens pictures in turn."""
    gains = itertools.cycle([0.7, 1.0])
    return lambda picture: (picture * next(gains)).astype(np.uint8)


def vanish(_):
    raise CalibrationError("Camera 0 no longer delivers pictures.", "")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (vanish, "no longer delivers pictures"),
        (lambda picture: np.full_like(picture, 100), "is not in the picture"),
        (lambda picture: picture[:, ::-1].copy(), "is mirrored"),
        (hunt(), "brightness of the picture keeps changing"),
    ],
)
def test_camera_calibration_moves_arm_only_once_board_is_seen(monkeypatch, spoil, message):
    arm, camera = hidden_arm(monkeypatch, "so101", 1)
    with open_own_arm(load_model("so101"), PORT) as opened:
        session = CameraCalibration(opened, SpoiledCamera(camera, 0, spoil), BOARD, 12)
        opened.enable()
        before = [joint.position for joint in arm.world.joints]
        with pytest.raises(CalibrationError, match=message):
            finish(session.run())
        after = [joint.position for joint in arm.world.joints]
        np.testing.assert_allclose(after, before, atol=0.01)


@pytest.mark.full
def test_frozen_camera_picture_ends_camera_calibration(monkeypatch):
    _, camera = hidden_arm(monkeypatch, "so101", 2)
    frozen = camera.take()
    with open_own_arm(load_model("so101"), PORT) as opened:
        session = CameraCalibration(opened, SpoiledCamera(camera, 0, lambda _: frozen), BOARD, 12)
        with pytest.raises(CalibrationError, match="same picture"):
            finish(session.run())


@pytest.mark.campaign
@pytest.mark.parametrize(("count", "suffices"), [(14, True), (40, False)])
def test_calibration_needs_at_least_half_of_requested_pictures(monkeypatch, count, suffices):
    _, camera = hidden_arm(monkeypatch, "so101", 1)
    hidden = "ikservo.apps.cameras.camera_calibration.is_visible"
    monkeypatch.setattr(hidden, lambda _board, _lens, poses: np.zeros(len(poses), bool))
    with open_own_arm(load_model("so101"), PORT) as opened:
        session = CameraCalibration(opened, camera, BOARD, count)
        if suffices:
            assert 7 <= finish(session.run()).pictures < count
            return
        with pytest.raises(CalibrationError, match="in only"):
            finish(session.run())
