"""A hostile camera at an address costs bounded time and memory."""

import json
import socket
import struct
import subprocess
import sys
import threading
import time
from contextlib import contextmanager, suppress

import numpy as np
import pytest

from ikservo.apps.cameras.capture import open_capture

cv2 = pytest.importorskip("cv2")
MIB = 1024 * 1024
PLAIN = b"HTTP/1.0 200 OK\r\nContent-Type: image/jpeg\r\n\r\n"
PARTS = b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=x\r\n\r\n"
PART = b"--x\r\nContent-Type: image/jpeg\r\n\r\n"
JPEG = cv2.imencode(".jpg", np.full((48, 64, 3), 128, np.uint8))[1].tobytes()
PNG = cv2.imencode(".png", np.full((48, 64, 3), 128, np.uint8))[1].tobytes()
_SIZE_AT = JPEG.index(b"\xff\xc0") + 5
HUGE = JPEG[:_SIZE_AT] + struct.pack(">HH", 65000, 65000) + JPEG[_SIZE_AT + 4 :]
HUGE_PNG = PNG[:16] + struct.pack(">II", 2**30, 2**30) + PNG[24:]


def forever(start, block, pause_s=0.0):
    yield start
    while True:
        yield block
        time.sleep(pause_s)


HOSTILE = {
    "endless picture": lambda: forever(PLAIN + JPEG[:100], bytes([18]) * MIB),
    "endless part": lambda: forever(PARTS + PART + JPEG[:100], bytes([18]) * MIB),
    "no boundary": lambda: forever(PARTS + JPEG[:100], bytes([18]) * MIB),
    "endless line": lambda: forever(b"HTTP/1.0 200 OK\r\nServer: ", b"x" * MIB),
    "endless noise": lambda: forever(PLAIN, bytes(range(256)) * 4096),
    "endless matroska": lambda: forever(
        PLAIN.replace(b"image/jpeg", b"video/webm") + b"\x1a\x45\xdf\xa3\x01" + b"\xff" * 7,
        bytes(MIB),
    ),
    "endless flash": lambda: forever(
        PLAIN + b"FLV\x01\x05\0\0\0\x09\0\0\0\0\x09\xff\xff\xff" + bytes(7), bytes([18]) * MIB
    ),
    "huge picture": lambda: forever(PLAIN + HUGE, HUGE),
    "huge parts": lambda: forever(PARTS, PART + HUGE + b"\r\n"),
    "huge png": lambda: forever(PLAIN.replace(b"jpeg", b"png") + HUGE_PNG, HUGE_PNG),
    "damaged parts": lambda: forever(PARTS, PART + JPEG[:300] + b"\r\n"),
    "slow drip": lambda: forever(PARTS + PART + JPEG[:100], b"\x12", 0.1),
    "silence": lambda: forever(b"", b"", 0.1),
    "ends at once": lambda: iter((b"",)),
}  # fmt: skip
TRY = """
import json, resource, sys, time
from pathlib import Path
from ikservo.apps.cameras.board_detection import LiveCamera
from ikservo.errors import IkservoError
start_s = time.monotonic()
try:
    camera = LiveCamera(sys.argv[1])
    outcome = [camera.take().shape for _ in range(2)]
    del camera
except IkservoError as error:
    camera = None
    outcome = error.message
status = Path("/proc/self/status").read_text()  # ru_maxrss counts the parent of this process, too
own = int(status.partition("VmHWM:")[2].split()[0]) // 1024
reader = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss // 1024
print(json.dumps([outcome, own, reader, time.monotonic() - start_s]))
"""


@contextmanager
def serving(blocks):
    """Serve what ``blocks()`` yields to every client; return the address."""

    def answer(connection):
        with suppress(OSError), connection:
            connection.recv(65536)
            for block in blocks():
                connection.sendall(block)

    def listen():
        with suppress(OSError):
            while True:
                connection, _ = server.accept()
                threading.Thread(target=answer, args=(connection,), daemon=True).start()

    with socket.create_server(("127.0.0.1", 0)) as server:
        threading.Thread(target=listen, daemon=True).start()
        yield f"http://127.0.0.1:{server.getsockname()[1]}/live"
        server.shutdown(socket.SHUT_RDWR)


def test_network_camera_delivers_its_pictures():
    with serving(lambda: forever(PARTS, PART + JPEG + b"\r\n", 0.01)) as address:
        camera = open_capture(address)
        assert camera.isOpened()
        assert camera.grab()
        taken, picture = camera.read()
        assert taken
        assert picture.shape == (48, 64, 3)
        assert abs(int(picture.mean()) - 128) < 2
        assert address not in " ".join(camera._reader.args)
        camera.release()
    assert camera._reader.returncode == 0
    assert not camera.grab()
    assert camera.read() == (False, None)


def test_missing_network_camera_is_refused():
    assert not open_capture("rtsp://127.0.0.1:1/live").isOpened()
    assert not open_capture("x" * 5000).isOpened()


@pytest.mark.full
@pytest.mark.skipif(sys.platform != "linux", reason="measures memory")
@pytest.mark.parametrize("blocks", HOSTILE.values(), ids=HOSTILE)
def test_hostile_network_camera_uses_bounded_time_and_memory(blocks):
    with serving(blocks) as address:
        ran = subprocess.run(
            [sys.executable, "-c", TRY, address], capture_output=True, timeout=60, check=True
        )
    _, own_mib, reader_mib, took_s = json.loads(ran.stdout)
    assert own_mib < 200
    assert reader_mib < 1200
    assert took_s < 20.0
    assert not ran.stderr
