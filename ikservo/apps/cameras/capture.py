"""Open a camera: by its number or device, an address, or a file of pictures."""

from __future__ import annotations

import os
import re
from typing import TYPE_CHECKING, Any, Protocol, cast
from urllib.parse import urlsplit

from ikservo.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = ["Capture", "open_capture", "public_source"]

_URL_TIMEOUT_MS = 3000
_LARGEST = 2**31 - 1  # number that OpenCV takes; no camera has it
_HIDDEN = "…"
_PUBLIC_QUERY = re.compile(
    r"(action|camera|channel|fps|height|profile|quality|resolution|stream|subtype|width)"
    r"=[\w.x-]{1,12}",
    re.ASCII | re.IGNORECASE,
)
"""Parts of a query that say which picture is meant; any other part may be a password."""


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


def public_source(source: str) -> str:
    """Return the name of a source of pictures without passwords.

    Every message, page and file names a source by this. Of an address it keeps scheme, host, port,
    path, and those parts of the query that are known to be harmless; "…" stands for what it leaves
    out. A public name is its own public name.
    """
    scheme, separator, rest = source.rpartition("://") if "://" in source else ("", "", source)
    if not separator:
        user, at, place = source.rpartition("@")  # an address whose scheme was forgotten
        return f"{_HIDDEN}@{place}" if at and ":" in user else source
    user, at, place = rest.rpartition("@")  # the last one: passwords may contain "@", "/" and "?"
    try:
        parts = urlsplit(f"//{place}")
        host, port = parts.hostname or "", f":{parts.port}" if parts.port else ""
    except ValueError:  # no valid port or address
        host, port, parts = _HIDDEN, "", urlsplit("")
    path = "/".join(_HIDDEN if "=" in part else part for part in parts.path.split("/"))
    query = "&".join(
        part if _PUBLIC_QUERY.fullmatch(part) else _HIDDEN for part in parts.query.split("&")
    )
    return (
        f"{scheme if re.fullmatch(r'[A-Za-z0-9+.-]+', scheme) else _HIDDEN}://"
        f"{f'{_HIDDEN}@' if at else ''}{f'[{host}]' if ':' in host else host}{port}{path}"
        f"{f'?{query}' if parts.query else ''}{f'#{_HIDDEN}' if parts.fragment else ''}"
    )


def open_capture(source: str) -> Capture:
    """Open a camera; OpenCV prints nothing of its own about one that is not there.

    Raises:
        InputError: The source is a public name from which the password was left out.
    """
    if _HIDDEN in source and "://" in source:
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
