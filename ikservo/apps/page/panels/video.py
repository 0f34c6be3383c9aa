"""Pictures of a camera for the page, as motion JPEG, read only while a page shows them."""

from __future__ import annotations

import asyncio
import contextlib
import math
import threading
from collections.abc import AsyncGenerator, Callable, Generator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ikservo.apps.cameras.board_detection import PictureSource
from ikservo.apps.cameras.camera_sources import SIMULATED_SOURCE
from ikservo.apps.cameras.capture import Capture, open_capture
from ikservo.clock import Clock
from ikservo.errors import IkservoError, InputError, PictureError
from ikservo.files.public_source import public_source

VIDEO_TYPE = "multipart/x-mixed-replace; boundary=picture"
_PERIOD_S = 1.0 / 15.0  # least time between two pictures that are only shown
_EARLY = 0.7  # fraction of that time after which a picture is kept: cameras jitter
_RETRY_S = 1.0  # time until a failed camera is opened again
_OLD_S = 2.0  # time without a picture after which the page reports it
_LOST_S = 10.0  # time without a picture after which the camera may be unplugged
_LOOK_S = 0.02  # period of polling for a new picture


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture to be sent: its number, counted from 1, and its JPEG data."""

    number: int
    jpeg: bytes


def source_name(source: str) -> str:
    """Return the title of a source, without passwords and folders."""
    if "://" in source:
        return public_source(source).partition("://")[2]
    is_numbered = source.isdecimal() or source == SIMULATED_SOURCE
    return f"camera {source}" if is_numbered else Path(public_source(source)).name


class VideoSource:
    """Reader of a camera in a separate thread; holds the newest picture.

    Args:
        source: The number of a camera, a device, an ``http://`` address or a file, which is
            repeated.
        clock: Clock for the time stamp of the last picture.
        open_source: Opens the source.

    Attributes:
        newest: The last picture (h, w) or (h, w, 3); None before the first.
        before: The transport of the arm that a simulated camera sees; None for real cameras.
        hint: A hint about the pictures; empty if there is none.

    Raises:
        InputError: There is no such device or file.
    """

    def __init__(
        self, source: str, clock: Clock, open_source: Callable[[str], Capture] = open_capture
    ) -> None:
        is_path = not source.isdecimal() and "://" not in source and source != SIMULATED_SOURCE
        is_there = not is_path
        with contextlib.suppress(OSError):  # raised for a name that is too long
            is_there = is_there or bool(source and Path(source).exists())
        if not is_there:
            name = public_source(source)
            raise InputError(f"There is no camera or file {name}.", "Is it plugged in?")
        self.source, self._clock, self._open = source, clock, open_source
        self._is_file = is_path and Path(source).is_file()
        self._is_paced = self._is_file or source == SIMULATED_SOURCE
        self.newest: NDArray[np.uint8] | None = None
        self.before: object = None
        self.hint = ""
        self._picture: Picture | None = None
        self._read_s, self._error = -math.inf, ""
        self._watchers = self._openings = 0
        self._period_s = _PERIOD_S
        self._watched_s = math.inf  # time since which a page shows it
        self._wanted, self._ending = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="ikservo camera", daemon=True)

    def __enter__(self) -> VideoSource:
        """Start the thread; the camera is opened when a page shows it."""
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """End the thread and close the camera."""
        self._ending.set()
        self._wanted.set()
        self._thread.join()

    @property
    def name(self) -> str:
        """Title of the source on the page."""
        return source_name(self.source)

    def can_be_opened(self) -> bool:
        """Open and close the source before it is shown; return whether that succeeds."""
        capture = self._open(self.source)
        try:
            return capture.isOpened()
        finally:
            capture.release()

    @property
    def trouble(self) -> str:
        """Problem with the shown pictures; empty if pictures arrive."""
        now_s = self._clock.now_s()
        if not self._watchers or now_s - max(self._read_s, self._watched_s) < _OLD_S:
            return ""
        if self.is_late:
            return f"The picture from {self.name} is late. Waiting for the next one."
        return self._error or f"No picture from {self.name}: is it plugged in?"

    @property
    def is_late(self) -> bool:
        """Whether a picture is overdue but may still come, because the camera has not failed."""
        waited_s = self._clock.now_s() - max(self._read_s, self._watched_s)
        return bool(self._watchers) and not self._error and _OLD_S <= waited_s < _LOST_S

    @property
    def is_fresh(self) -> bool:
        """Whether the newest picture is recent."""
        return self._picture is not None and self._clock.now_s() - self._read_s < _OLD_S

    @property
    def picture(self) -> Picture | None:
        """The newest picture as JPEG data; None before the first."""
        return self._picture

    @property
    def series(self) -> tuple[int, ...]:
        """A value that changes if the camera is opened again or its pictures change their size."""
        return () if self.newest is None else (self._openings, *self.newest.shape[:2])

    def age_s(self) -> float:
        """Return the age of the newest picture; infinite before the first."""
        return math.inf if self._picture is None else self._clock.now_s() - self._read_s

    @contextlib.contextmanager
    def watched(self, period_s: float = _PERIOD_S) -> Generator[None]:
        """Read the camera even if no page shows it, at most one picture per ``period_s``."""
        self._begin_watching()
        self._period_s = period_s
        try:
            yield
        finally:
            self._period_s = _PERIOD_S
            self._watchers -= 1

    def _begin_watching(self) -> None:
        if not self._watchers:
            self._watched_s = self._clock.now_s()
        self._watchers += 1
        self._wanted.set()

    def switch(self, open_source: Callable[[str], Capture], before: object) -> None:
        """Read another simulated camera from now on; ``before`` is the transport of its arm."""
        self._open, self.before = open_source, before

    def take(self) -> NDArray[np.uint8]:
        """Wait for a picture that was taken after this call (``PictureSource``).

        Raises:
            PictureError: The camera delivers no picture.
        """
        last, new = self._picture, 0
        for _ in range(round(_LOST_S / _LOOK_S)):
            self._ending.wait(_LOOK_S)
            picture, newest = self._picture, self.newest
            new, last = new + (picture is not last), picture
            if new > 1 and picture is not None and newest is not None:  # the first is too old
                return newest
        raise PictureError(self._error or f"No picture from {self.name}.", "Is it plugged in?")

    async def stream(self) -> AsyncGenerator[bytes]:
        """Yield new pictures as parts of ``VIDEO_TYPE``; a slow page misses some."""
        self._begin_watching()
        number = 0
        try:
            while not self._ending.is_set():
                picture = self._picture
                if picture is not None and picture.number != number:
                    number = picture.number
                    header = (
                        "--picture\r\nContent-Type: image/jpeg\r\n"
                        f"Content-Length: {len(picture.jpeg)}\r\n\r\n"
                    )
                    yield header.encode() + picture.jpeg + b"\r\n"
                await asyncio.sleep(_LOOK_S)
        finally:
            self._watchers -= 1

    def _run(self) -> None:
        """Read while a page shows the pictures; reopen a failed camera periodically."""
        while not self._ending.is_set():
            self._wanted.wait()
            try:
                self._read_while_watched()
            except Exception as error:  # a driver may raise anything, and then recover
                ours = isinstance(error, IkservoError)
                failure = f"{error!r}".replace(self.source, self.name)
                why = error.message if ours else f"it failed: {failure}."
                self._error = f"No picture from {self.name}: {why}"
            if not self._watchers:
                self._wanted.clear()
                self._picture = None
            elif not self._is_file or self._error:
                self._ending.wait(_RETRY_S)

    def _read_while_watched(self) -> None:
        """Read until no page shows the pictures or the camera fails."""
        opened = self._open
        capture = opened(self.source)
        self._openings += not self._is_file  # a file is repeated
        try:
            self._error = "" if capture.isOpened() else f"{self.name} cannot be opened."
            while self._open is opened and self._watchers and not self._ending.is_set():
                if self._error:
                    return
                ready, image = capture.read()
                if not ready or image is None:
                    return
                self._keep(image)
        finally:
            capture.release()

    def _keep(self, image: NDArray[np.uint8]) -> None:
        """Store a picture as JPEG; if a camera is faster than the page, some are not shown."""
        now_s = self._clock.now_s()
        if self._is_paced:
            self._ending.wait(self._period_s)
        elif now_s - self._read_s < _EARLY * self._period_s:
            return
        import cv2  # noqa: PLC0415  # from the extra `camera`

        coloured = image if image.ndim == 3 else np.repeat(image[:, :, None], 3, axis=2)
        _, jpeg = cv2.imencode(".jpg", coloured)  # data sets have three channels
        self.newest = image
        number = 1 if self._picture is None else self._picture.number + 1
        self._picture, self._read_s = Picture(number, jpeg.tobytes()), now_s


class PictureCapture:
    """Camera that takes single pictures from a source."""

    def __init__(self, source: PictureSource) -> None:
        self._source = source

    def isOpened(self) -> bool:  # noqa: N802  # OpenCV's name
        """Return True."""
        return True

    def read(self) -> tuple[bool, NDArray[np.uint8] | None]:
        """Take a picture."""
        return True, self._source.take()

    def grab(self) -> bool:
        """Return True; there is no queue to skip."""
        return True

    def release(self) -> None:
        """Do nothing."""
