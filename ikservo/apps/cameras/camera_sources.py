"""Open a camera for single pictures: a real camera, or the camera of a simulated arm."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import entry_points
from typing import cast

from ikservo.apps.cameras.board import Board
from ikservo.apps.cameras.board_detection import LiveCamera, PictureSource
from ikservo.errors import InputError
from ikservo.remedies import install_hint

SIMULATED_SOURCE = "sim"
_GROUP = "ikservo.cameras"


def open_source(source: str, transport: object, board: Board) -> PictureSource:
    """Open a camera.

    The source is a number, a device, an address, or ``sim`` for the camera of a simulated arm.

    Raises:
        InputError: OpenCV is not installed, or there is no such camera.
    """
    if source != SIMULATED_SOURCE:
        return LiveCamera(source)
    for point in entry_points(group=_GROUP, name=SIMULATED_SOURCE):
        opener = cast("Callable[[object, object], PictureSource | None]", point.load())
        camera = opener(transport, board.opencv())
        if camera is not None:
            camera.hint = "\n".join(filter(None, (camera.hint, install_hint(camera.hint))))
            return camera
    raise InputError("The simulated camera sees a simulated arm only.", "Add: --port sim")
