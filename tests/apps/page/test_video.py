"""The camera's picture needs the page's key, is read only while watched, and reports faults."""

import asyncio
import json
import subprocess
import sys

import httpx
import numpy as np
import pytest

from ikservo.apps.page.page_app import ViewApp
from ikservo.apps.page.panels.video import VideoSource
from ikservo.apps.page.served_arms import ArmAtPort
from ikservo.clock import RealClock
from ikservo.errors import InputError, PictureError
from ikservo.model import load_model
from tests.apps.page.socket_clients import SocketClient
from tests.apps.page.webcam import Webcam
from tests.browser.page_operator import until

cv2 = pytest.importorskip("cv2")


class SteppedClock(RealClock):
    """A real-time clock that a test advances."""

    ahead_s = 0.0

    def now_s(self):
        return super().now_s() + self.ahead_s


@pytest.fixture
def film(tmp_path):
    """Return a file with two blue pictures."""
    path = tmp_path / "film.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10, (64, 48))
    for _ in range(2):
        writer.write(np.full((48, 64, 3), (255, 0, 0), np.uint8))
    writer.release()
    return path


def picture_of(part):
    header, _, jpeg = part.partition(b"\r\n\r\n")
    assert header.startswith(b"--picture\r\nContent-Type: image/jpeg")
    return cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)


@pytest.mark.full
def test_camera_picture_is_streamed_once_per_address(film):
    app = ViewApp([ArmAtPort(load_model("planar2"), "sim")], cameras=[str(film)])
    with app as urls, app.serve_in_thread():
        url = urls.control.partition("/#")[0]
        client = SocketClient(url, path="/arms").prove(app.keys.watch)
        assert client.receive_kind("arms")["arms"][0]["camera"] == {
            "name": "film.avi",
            "trouble": "",
            "late": False,
            "calibrated": False,
            "choices": ["film.avi"],
            "chosen": "film.avi",
        }
        client.send_message("show_camera", arm="planar2")
        address = f"{url}/{client.receive_kind('camera_url')['url']}"
        with httpx.stream("GET", address, timeout=20) as answer:
            assert answer.headers["content-type"].startswith("multipart/x-mixed-replace")
            assert "default-src 'none'" in answer.headers["content-security-policy"]
            received = b""
            for part in answer.iter_bytes():
                received += part
                if received.count(b"--picture") > 3:  # the file has two: it is repeated
                    break
        assert picture_of(received)[0, 0].tolist() == pytest.approx([255, 0, 0], abs=6)
        assert httpx.get(address).status_code == 404
        client.close()


def test_camera_is_read_only_while_its_picture_is_shown():
    webcam, clock = Webcam(), SteppedClock()
    with VideoSource("0", clock, webcam.open) as source:
        assert (webcam.opened, source.trouble) == (0, "")
        loop, looking = asyncio.new_event_loop(), source.stream()
        red = picture_of(loop.run_until_complete(anext(looking)))
        assert red[0, 0].tolist() == pytest.approx([0, 0, 255], abs=6)
        assert source.trouble == ""
        webcam.plugged = False
        clock.ahead_s = 3.0
        until(lambda: "camera 0 cannot be opened" in source.trouble)
        webcam.plugged = True
        until(lambda: not source.trouble)
        loop.run_until_complete(looking.aclose())  # as the server does once its page is gone
        loop.close()
        until(lambda: webcam.released == webcam.opened)


def test_camera_without_picture_for_10_s_counts_as_lost():
    webcam, clock = Webcam(), SteppedClock()
    with VideoSource("0", clock, webcam.open) as source:
        loop, looking = asyncio.new_event_loop(), source.stream()
        loop.run_until_complete(anext(looking))
        webcam.delivers.clear()
        until(lambda: webcam.is_held)
        clock.ahead_s += 3.0
        assert source.is_late
        assert source.trouble == "The picture from camera 0 is late. Waiting for the next one."
        clock.ahead_s += 8.0
        assert not source.is_late
        assert source.trouble == "No picture from camera 0: is it plugged in?"
        webcam.delivers.set()
        until(lambda: not source.trouble)
        loop.run_until_complete(looking.aclose())
        loop.close()


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (PictureError("Camera 0 no longer delivers pictures."), "no longer delivers pictures"),
        (RuntimeError("a driver"), "it failed: RuntimeError('a driver')"),
    ],
)
def test_camera_error_is_reported_until_picture_returns(error, said):
    webcam, clock = Webcam(), SteppedClock()
    with VideoSource("0", clock, webcam.open) as source:
        loop, looking = asyncio.new_event_loop(), source.stream()
        loop.run_until_complete(anext(looking))
        webcam.error = error
        clock.ahead_s = 3.0
        until(lambda: said in source.trouble, lambda: source.trouble)
        assert not source.is_fresh
        webcam.error = None
        until(lambda: source.is_fresh and not source.trouble)
        loop.run_until_complete(looking.aclose())
        loop.close()
        until(lambda: webcam.released == webcam.opened)


def test_picture_for_calibration_is_newer_than_its_request():
    webcam = Webcam()
    with VideoSource("0", RealClock(), webcam.open) as source, source.watched():
        until(lambda: source.picture)
        for _ in range(3):
            before = source.picture.number
            assert source.take().shape == (24, 32, 3)
            assert source.picture.number >= before + 2  # the first may show an earlier moment


def test_lost_camera_ends_wait_for_picture(monkeypatch):
    monkeypatch.setattr("ikservo.apps.page.panels.video._LOST_S", 0.2)
    webcam = Webcam()
    webcam.plugged = False
    with VideoSource("0", RealClock(), webcam.open) as source, source.watched():
        until(lambda: webcam.opened)
        with pytest.raises(PictureError, match="camera 0 cannot be opened") as lost:
            source.take()
    assert lost.value.hint == "Is it plugged in?"


@pytest.mark.parametrize("source", ["/dev/videoNOTHERE", "film.mp4", "", 5000 * "a"])
def test_missing_camera_is_refused(source):
    with pytest.raises(InputError, match=f"no camera or file {source}"):
        VideoSource(source, RealClock())


def test_camera_name_omits_secrets_of_its_address():
    source = VideoSource("http://user:secret@cam.lan:8080/video?key=secret", RealClock())
    assert source.name == "…@cam.lan:8080/video?…"
    assert VideoSource("http://[cam", RealClock()).name == "…"


def test_camera_probe_prints_nothing_from_driver():
    pytest.importorskip("cv2")
    program = """if True:
        from ikservo.clock import RealClock
        from ikservo.apps.page.panels.video import VideoSource
        for source in ("http://[cam", "http://127.0.0.1:1/video", 5000 * "9"):
            assert not VideoSource(source, RealClock()).can_be_opened()"""
    run = subprocess.run(  # FFmpeg is told once for each process
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False
    )
    assert (run.returncode, run.stdout, run.stderr) == (0, "", "")


@pytest.mark.full
def test_page_without_camera_refuses_camera_view():
    app = ViewApp([ArmAtPort(load_model("planar2"), "sim")])
    with app as urls, app.serve_in_thread():
        client = SocketClient(urls.control.partition("/#")[0], path="/arms").prove(app.keys.control)
        assert client.receive_kind("arms")["arms"][0]["camera"] is None
        client.send_message("show_camera", arm="planar2")
        assert "no camera" in json.dumps(client.receive_kind("refused"))
        client.close()
