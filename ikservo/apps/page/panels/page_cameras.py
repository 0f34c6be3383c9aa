"""The cameras of a page: each arm shows its calibrated camera or a chosen camera."""

from __future__ import annotations

import threading
from collections.abc import Generator, Sequence
from contextlib import ExitStack, contextmanager, suppress

from ikservo.apps.cameras.arm_camera import camera_key, known_camera
from ikservo.apps.cameras.board import Board
from ikservo.apps.cameras.camera_file import camera_names
from ikservo.apps.cameras.camera_sources import SIMULATED_SOURCE, open_source
from ikservo.apps.page.panels.video import PictureCapture, VideoSource, source_name
from ikservo.arm import Arm
from ikservo.cli.camera_options import DEFAULT_BOARD, CameraOptions
from ikservo.clock import Clock
from ikservo.errors import IkservoError, InputError, UnknownNameError
from ikservo.files.public_source import public_source


class PageCameras:
    """Lookup of the pictures that belong to each arm.

    Args:
        clock: Clock for the time stamps of pictures.
        sources: The sources that ``VideoSource`` reads, and ``sim``.
        name: The name of the camera of each arm; empty for none. Without sources, pictures
            come from the camera with which the arm was calibrated.

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

    @property
    def names(self) -> list[str]:
        """Names of the sources."""
        return [source_name(source) for source in self._sources]

    def find_missing(self) -> list[str]:
        """Try every real camera; return the names of missing cameras."""
        return [video.name for video in self._videos.values() if not video.can_be_opened()]

    def __enter__(self) -> PageCameras:
        """Start; a camera is opened when a page shows it."""
        for video in self._videos.values():
            self._exits.enter_context(video)
        return self

    def __exit__(self, *_: object) -> None:
        """Close the cameras."""
        self._exits.close()

    def open_before(
        self, arm: Arm, exits: ExitStack, source: str | None = None
    ) -> VideoSource | None:
        """Open the video source that the page shows for an arm; None if there is no source.

        ``exits`` closes a simulated camera, which belongs to this arm alone.

        Raises:
            CalibrationError: A camera is named, but the arm has no calibrated camera.
            InputError: The camera is unknown, missing, or belongs to another arm.
            FileFormatError: A file about the camera is damaged.
        """
        source = source or self._source_before(arm)
        if source is None:
            return None
        if source == SIMULATED_SOURCE:
            video = VideoSource(source, self._clock)
            _see(video, arm)
            return exits.enter_context(video)
        with self._lock:
            if source not in self._videos:
                video = VideoSource(source, self._clock)
                self._videos[source] = self._exits.enter_context(video)
            return self._videos[source]

    def choices(self, arm: Arm) -> dict[str, tuple[str, str]]:
        """Return source and name of each camera that an arm may show, by its title.

        Raises:
            FileFormatError: A file about a camera is damaged.
        """
        own = camera_names(arm.model.name, camera_key(arm.context))
        known = {name: known_camera(arm.context, name)[0].source for name in own}
        names = {self._given(source) or source: name for name, source in known.items()}
        sources, first = self._sources or (names if self.name else ()), self._source_before(arm)
        if self.name and first is not None:
            names.setdefault(first, self.name)  # its number has changed since the calibration
        found = [(source, names.get(source, "")) for source in sources]
        return {name or source_name(source): (source, name) for source, name in found}

    def _source_before(self, arm: Arm) -> str | None:
        """Return the source with which an arm was calibrated, or the first source."""
        first = next(iter(self._sources), None)
        if self.name:
            own = known_camera(arm.context, self.name)[0].source
            return self._given(own) or first or own
        for source in self._sources:
            with suppress(IkservoError):
                if self._given(known_camera(arm.context, source=source)[0].source) == source:
                    return source
        return first

    def _given(self, stored: str) -> str | None:
        """Return the given source, with its password, that matches a stored source."""
        name = public_source(stored)
        return next((each for each in self._sources if public_source(each) == name), None)


class ArmCameras:
    """The cameras that an arm of a page may show, and the camera that it shows now.

    Args:
        cameras: The cameras of the page.
        arm: The arm.
        exits: Stack that closes the opened cameras.

    Attributes:
        video: The source of the pictures that are shown; None if none are shown.
        name: The name of the shown camera; see ``CameraView``.
        choices: See ``PageCameras.choices``.
        chosen: The title of the shown camera; empty if no camera is shown.

    Raises:
        IkservoError: See ``PageCameras.open_before``.
    """

    def __init__(self, cameras: PageCameras, arm: Arm, exits: ExitStack) -> None:
        self._cameras, self._arm, self._exits = cameras, arm, exits
        self.video, self.name = cameras.open_before(arm, exits), cameras.name
        self.choices = cameras.choices(arm)
        shown = self.video and self.video.source
        self.chosen = next((each for each, own in self.choices.items() if own[0] == shown), "")
        self._opened = {} if self.video is None else {self.video.source: self.video}

    def choose(self, choice: str) -> None:
        """Show another camera from now on.

        Raises:
            UnknownNameError: The camera is not among the choices.
            InputError: The camera is missing.
        """
        if choice not in self.choices:
            raise UnknownNameError("camera", choice, self.choices)
        source, name = self.choices[choice]
        self.video, self.name, self.chosen = self._open(source), name, choice

    def open_all(self) -> dict[str, VideoSource]:
        """Open every camera that the arm may show; return them by their titles.

        Raises:
            InputError: A camera is missing.
        """
        return {title: self._open(source) for title, (source, _) in self.choices.items()}

    def follow(self, arm: Arm) -> None:
        """Show a reopened arm; simulated cameras see its new simulation."""
        self._arm = arm
        for video in list(self._opened.values()):  # the server's thread may open another one
            if video.source == SIMULATED_SOURCE:
                _see(video, arm)

    @contextmanager
    def calibrating(self) -> Generator[tuple[VideoSource, CameraOptions]]:
        """Read the shown camera for a calibration of the arm; pages may show it meanwhile.

        Raises:
            InputError: No camera is shown.
        """
        video, name = self.video, self.name or self.choices.get(self.chosen, ("", ""))[1]
        if video is None:
            raise InputError("This page shows no camera.", "Choose one.")
        with video.watched():
            yield video, CameraOptions(camera=video.source, camera_name=name)

    def _open(self, source: str) -> VideoSource:
        if source not in self._opened:
            video = self._cameras.open_before(self._arm, self._exits, source)
            if video is not None:
                self._opened[source] = video
        return self._opened[source]


def _see(video: VideoSource, arm: Arm) -> None:
    """Let a simulated camera see a simulated arm."""
    transport = arm.context.port.transport
    camera = open_source(video.source, transport, Board.named(DEFAULT_BOARD))
    video.hint = camera.hint
    video.switch(lambda _: PictureCapture(camera), transport)
