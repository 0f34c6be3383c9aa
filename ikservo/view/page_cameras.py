"""The cameras of a page: each arm shows the one that it was calibrated with."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import ExitStack, suppress

from ikservo.arm import Arm
from ikservo.arm.camera import known_camera
from ikservo.clock import Clock
from ikservo.errors import IkservoError
from ikservo.eyes.board import DEFAULT_BOARD, Board
from ikservo.eyes.sources import SIMULATED_SOURCE, open_source
from ikservo.view.video import PictureCapture, VideoSource

__all__ = ["PageCameras"]


class PageCameras:
    """Finds the pictures that belong to each arm.

    Args:
        clock: Tells how old pictures are.
        sources: What ``VideoSource`` reads, and ``sim``.
        name: Of the camera of each arm; empty for none. Without sources it is read from where the
            arm was calibrated with it.

    Raises:
        InputError: There is no such device or file.
    """

    def __init__(self, clock: Clock, sources: Sequence[str] = (), name: str = "") -> None:
        self._clock, self._sources, self.name = clock, sources, name
        self._lock, self._exits = threading.Lock(), ExitStack()
        self._videos: dict[str, VideoSource] = {}
        for source in sources:
            if source != SIMULATED_SOURCE:
                self._videos[source] = VideoSource(source, clock)

    def __enter__(self) -> PageCameras:
        """Start to read; a camera is opened once somebody looks."""
        for video in self._videos.values():
            self._exits.enter_context(video)
        return self

    def __exit__(self, *_: object) -> None:
        """Close the cameras."""
        self._exits.close()

    def open_before(self, arm: Arm, exits: ExitStack) -> VideoSource | None:
        """Return the pictures that an arm shows; None if it shows none.

        Args:
            arm: The arm.
            exits: Closes a simulated camera, which stands before this arm alone.

        Raises:
            CalibrationError: The arm has no calibrated camera, and one is named.
            InputError: It has none of that name, or it is not there, or not that of this arm.
            FileFormatError: A file about it is damaged.
        """
        source = self._source_before(arm)
        if source is None:
            return None
        if source == SIMULATED_SOURCE:
            transport = arm.context.port.transport
            camera = open_source(source, transport, Board.named(DEFAULT_BOARD))
            video = VideoSource(source, self._clock, lambda _: PictureCapture(camera))
            video.before, video.hint = transport, camera.hint
            return exits.enter_context(video)
        with self._lock:
            if source not in self._videos:
                video = VideoSource(source, self._clock)
                self._videos[source] = self._exits.enter_context(video)
            return self._videos[source]

    def _source_before(self, arm: Arm) -> str | None:
        """Return the source that an arm was calibrated with, or the first one."""
        first = next(iter(self._sources), None)
        if self.name:
            own = known_camera(arm.context, self.name)[0].source
            return own if first is None or own in self._sources else first
        for source in self._sources:
            with suppress(IkservoError):
                if known_camera(arm.context, source=source)[0].source == source:
                    return source
        return first
