"""Open a camera by number, device or address, or a file with pictures."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import ModuleType
from typing import IO, TYPE_CHECKING, Any, Protocol, cast

import numpy as np

from ikservo.errors import InputError
from ikservo.files.public_source import HIDDEN

if TYPE_CHECKING:
    from numpy.typing import NDArray

_URL_TIMEOUT_MS = 3000
_LARGEST = 2**31 - 1  # largest number that OpenCV accepts; no camera has it
_MAX_REQUEST_S = 10.0  # FFmpeg gives up on a silent address after one or two of its time-outs
_MAX_MEMORY_BYTES = 1024 * 1024 * 1024  # memory limit of a reader; 8K video needs less
_WATCH_S = 0.01  # period of the checks of a reader's memory and time
_END_S = 2.0  # time in which a reader ends its session with the camera
_ANSWER = struct.Struct("<?III")  # success; height, width and channels of the picture that follows
_GRAB, _READ = b"g", b"r"


class Capture(Protocol):
    """The methods of ``cv2.VideoCapture`` that are used here."""

    def isOpened(self) -> bool:  # noqa: N802  # OpenCV's name
        """Check whether pictures can be read."""
        ...

    def read(self) -> tuple[bool, NDArray[np.uint8] | None]:
        """Return whether there is a next picture, and that picture (h, w, 3)."""
        ...

    def grab(self) -> bool:
        """Discard the next picture; return whether there was one."""
        ...

    def release(self) -> None:
        """Close the camera."""
        ...


def open_capture(source: str) -> Capture:
    """Open a camera; OpenCV's messages about a missing camera are suppressed.

    Raises:
        InputError: The source is an address without its password.
    """
    if HIDDEN in source and "://" in source:
        raise InputError(
            f"The password of {source} is not stored.", "Give the full address of the camera."
        )
    cv2 = _silent_opencv()
    if source.isdecimal():
        return cv2.VideoCapture(min(int(source[:10]), _LARGEST))
    if "://" not in source and os.path.exists(source):  # noqa: PTH110  # unlike Path, never raises
        return cv2.VideoCapture(source)
    return AddressCapture(source)


class AddressCapture:
    """A camera at an address, read by a process whose time and memory are bounded.

    FFmpeg keeps a picture in memory until it is complete, and allocates the size in its header.

    Args:
        source: The address. It may contain a password, so it is not on the command line.
    """

    def __init__(self, source: str) -> None:
        self._reader = subprocess.Popen(  # noqa: S603  # this Python and this module
            [sys.executable, "-P", "-m", __name__],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        self._requests = cast("IO[bytes]", self._reader.stdin)
        self._answers = cast("IO[bytes]", self._reader.stdout)
        self._is_opened, _ = self._ask(source.encode(errors="replace") + b"\n")

    def __del__(self) -> None:
        """Close the camera when it is deleted, as OpenCV does."""
        self.release()

    def isOpened(self) -> bool:  # noqa: N802  # OpenCV's name
        """Check whether pictures can be read."""
        return self._is_opened

    def read(self) -> tuple[bool, NDArray[np.uint8] | None]:
        """Return whether there is a next picture, and that picture (h, w, 3)."""
        return self._ask(_READ)

    def grab(self) -> bool:
        """Discard the next picture; return whether there was one."""
        return self._ask(_GRAB)[0]

    def release(self) -> None:
        """Close the camera, and end the process that reads it."""
        for pipe in (self._requests, self._answers):
            with contextlib.suppress(OSError):  # the process has already ended
                pipe.close()
        try:
            self._reader.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._reader.kill()
            self._reader.wait()

    def _ask(self, request: bytes) -> tuple[bool, NDArray[np.uint8] | None]:
        """Send a request to the reading process; return its answer (no picture if it has ended)."""
        try:
            self._requests.write(request)
            self._requests.flush()
            success, *shape = _ANSWER.unpack(self._answers.read(_ANSWER.size))
            pixels = np.frombuffer(self._answers.read(math.prod(shape)), np.uint8)
            return success, pixels.reshape(shape) if pixels.size else None
        except (OSError, ValueError, struct.error):
            return False, None


def _silent_opencv() -> ModuleType:
    """Return OpenCV with the messages of OpenCV and FFmpeg switched off."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    import cv2  # noqa: PLC0415  # from the extra `camera`

    logging = cast("Any", cv2).utils.logging  # missing from its stubs
    logging.setLogLevel(logging.LOG_LEVEL_SILENT)
    return cv2


def _serve_pictures() -> None:
    """Answer the requests from an ``AddressCapture`` until it closes its end of the pipe."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is meant for the process that asks
    cv2 = _silent_opencv()
    source = sys.stdin.buffer.readline().decode().rstrip("\n")
    asked_s = [time.monotonic()]
    threading.Thread(target=_end_at_bounds, args=(asked_s,), daemon=True).start()
    timeouts = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, _URL_TIMEOUT_MS,
                cv2.CAP_PROP_READ_TIMEOUT_MSEC, _URL_TIMEOUT_MS]  # fmt: skip
    capture = cv2.VideoCapture(source, cv2.CAP_FFMPEG, timeouts)
    success, picture = capture.isOpened(), None
    while True:
        asked_s[0] = math.inf
        shape = (0, 0, 0) if picture is None else picture.shape
        sys.stdout.buffer.write(_ANSWER.pack(success, *shape))
        sys.stdout.buffer.write(b"" if picture is None else picture.tobytes())
        sys.stdout.buffer.flush()
        request = sys.stdin.buffer.read(1)
        asked_s[0] = time.monotonic()
        if not request:
            return capture.release()
        success, picture = capture.read() if request == _READ else (capture.grab(), None)


def _end_at_bounds(asked_s: list[float]) -> None:
    """End this process if a request takes too long or if the process uses too much memory.

    Args:
        asked_s: Time of the present request, s; infinite if there is no request.
    """
    while time.monotonic() - asked_s[0] < _MAX_REQUEST_S and _used_bytes() < _MAX_MEMORY_BYTES:
        time.sleep(_WATCH_S)
    os._exit(1)


def _used_bytes() -> int:
    """Return the memory use of this process: present on Linux, peak on macOS, 0 on Windows."""
    if sys.platform == "win32":
        return 0
    with contextlib.suppress(OSError):
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    import resource  # noqa: PLC0415  # not on Windows

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


if __name__ == "__main__":
    _serve_pictures()
