"""Allowed and forbidden names of picture sources."""

import numpy as np
import pytest

from ikservo.errors import InputError, PictureError
from ikservo.files.public_source import public_source

SECRET = "swordfish"
WITH_SECRETS = {
    "user and password": (f"rtsp://admin:{SECRET}@cam.lan:554/live/1", "rtsp://…@cam.lan:554/live/1"),
    "a user only": (f"http://{SECRET}@cam.lan/", "http://…@cam.lan/"),
    "an @ in the password": (f"rtsp://admin:{SECRET}@{SECRET}@cam/1", "rtsp://…@cam/1"),
    "a slash in the password": (f"rtsp://admin:a/{SECRET}@cam/1", "rtsp://…@cam/1"),
    "a # in the password": (f"rtsp://admin:#{SECRET}@cam/1", "rtsp://…@cam/1"),
    "a ? in the password": (f"rtsp://admin:?{SECRET}@cam/1", "rtsp://…@cam/1"),
    "a token": (f"http://cam/video?channel=2&token={SECRET}", "http://cam/video?channel=2&…"),
    "a bare token": (f"http://cam/video?{SECRET}", "http://cam/video?…"),
    "a fragment": (f"http://cam/video#{SECRET}", "http://cam/video#…"),
    "a password in the path": (
        f"rtsp://cam/user=admin_password={SECRET}_channel=1.sdp", "rtsp://cam/…",
    ),
    "an invalid port": (f"rtsp://admin:{SECRET}", "rtsp://…"),
    "an invalid address": (f"http://[{SECRET}", "http://…"),
    "no scheme": (f"admin:{SECRET}@cam.lan/1", "…@cam.lan/1"),
    "a pipeline": (f"rtspsrc user-pw={SECRET} location=rtsp://cam/1", "…://cam/1"),
}  # fmt: skip


@pytest.mark.parametrize(("source", "name"), WITH_SECRETS.values(), ids=WITH_SECRETS)
def test_displayed_camera_source_omits_password(source, name):
    assert public_source(source) == name
    assert public_source(name) == name


@pytest.mark.parametrize(
    "source",
    [
        "0",
        "sim",
        "/dev/video0",
        "board@home.png",
        "http://[::1]:8080/?action=stream",
        "rtsp://cam/1",
    ],
)
def test_displayed_camera_source_without_secret_is_unchanged(source):
    assert public_source(source) == source


class SilentCamera:
    """A camera that opens and delivers nothing."""

    def isOpened(self):  # noqa: N802
        return True

    def grab(self):
        return False

    def read(self):
        return False, None


def test_camera_errors_hide_password(monkeypatch):
    pytest.importorskip("cv2")
    from ikservo.apps.cameras import board_detection

    address = f"rtsp://admin:{SECRET}@127.0.0.1:1/live"
    with pytest.raises(InputError, match=r"There is no camera rtsp://…@127.0.0.1:1/live") as error:
        board_detection.LiveCamera(address)
    assert SECRET not in repr(error.value)
    with pytest.raises(InputError, match=r"password of rtsp://…@127.0.0.1:1/live is not stored"):
        board_detection.LiveCamera(public_source(address))
    monkeypatch.setattr(board_detection, "open_capture", lambda _: SilentCamera())
    with pytest.raises(
        PictureError, match=r"rtsp://…@127.0.0.1:1/live no longer delivers pictures"
    ):
        board_detection.LiveCamera(address).take()


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_picture_file_can_be_read_repeatedly(tmp_path, suffix):
    cv2 = pytest.importorskip("cv2")
    from ikservo.apps.cameras.board_detection import LiveCamera

    path = tmp_path / f"board{suffix}"
    cv2.imwrite(str(path), np.full((48, 64, 3), 128, np.uint8))
    camera = LiveCamera(str(path))
    assert [camera.take().shape for _ in range(3)] == 3 * [(48, 64, 3)]


@pytest.mark.parametrize("content", [b"hello", b"\x89PNG\r\n\x1a\nxx"])
def test_damaged_picture_file_is_not_reported_as_unplugged(tmp_path, content):
    pytest.importorskip("cv2")
    from ikservo.apps.cameras.board_detection import LiveCamera

    path = tmp_path / "board.png"
    path.write_bytes(content)
    with pytest.raises((InputError, PictureError), match=r"board.png is not a picture or video"):
        LiveCamera(str(path)).take()
