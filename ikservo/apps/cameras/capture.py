"""Open a camera: by its number or device, an address, or a file of pictures."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, Protocol, cast

from ikservo.errors import InputError
from ikservo.files.public_source import HIDDEN

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_URL_TIMEOUT_MS = 3000
_LARGEST = 2**31 - 1  # number that OpenCV takes; no camera has it


class Capture(Protocol):
    """What is used of ``cv2.VideoCapture``."""

    def isOpened(self) -> bool:  # noqa: N802  # OpenCV's name
        """Check whether pictures can be read."""
        ...

    def read(self) -> tuple[bool, NDArray[np.uint8] | None]:
        """Check whether there is a next picture, and the picture (h, w, 3)."""
        ...

    def grab(self) -> bool:
        """Throw the next picture away; check whether there was one."""
        ...

    def release(self) -> None:
        """Close it."""
        ...


def open_capture(source: str) -> Capture:
    """Open a camera; OpenCV prints nothing of its own about one that is not there.

    Raises:
        InputError: The source is a public name from which the password was left out.
    """
    if HIDDEN in source and "://" in source:
        raise InputError(
            f"The password of {source} is not stored.", "Give the whole address of the camera."
        )
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # nor does FFmpeg
    import cv2  # noqa: PLC0415  # of the extra `camera`

    logging = cast("Any", cv2).utils.logging  # missing in its stubs
    logging.setLogLevel(logging.LOG_LEVEL_SILENT)
    if source.isdecimal():
        return cv2.VideoCapture(min(int(source[:10]), _LARGEST))
    if "://" in source:
        timeouts = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, _URL_TIMEOUT_MS,
                    cv2.CAP_PROP_READ_TIMEOUT_MSEC, _URL_TIMEOUT_MS]  # fmt: skip
        return cv2.VideoCapture(source, cv2.CAP_FFMPEG, timeouts)
    return cv2.VideoCapture(source)
