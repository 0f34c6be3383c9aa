"""Record the arm of a page, with its cameras, as episodes of a data set."""

from __future__ import annotations

import math
import re
import threading
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ikservo.apps.page.messages.page_messages import RecordEpisode
from ikservo.apps.page.panels.page_cameras import ArmCameras
from ikservo.apps.page.running.arm_thread import ArmThread
from ikservo.apps.page.server.message_age_and_rate import Client
from ikservo.apps.page.server.server import Frame
from ikservo.apps.teaching.dataset_writing import DatasetWriter, NewEpisode, rows_at
from ikservo.apps.teaching.lerobot_values import JointValues
from ikservo.clock import Clock, Rate
from ikservo.errors import IkservoError, InputError
from ikservo.kinematics.arrays import Vector

FPS = 30
_OLD_S = 0.5  # an episode ends if the arm was not read for longer
_LONGEST_S = 600.0
_MOST_PICTURE_BYTES = 256 * 1024 * 1024  # per episode, because they are kept in memory


@dataclass(frozen=True, slots=True)
class EpisodeFolder:
    """The data set to which a page records.

    Attributes:
        folder: Its folder.
        task: The task of the episodes.
    """

    folder: Path
    task: str


@dataclass(frozen=True, slots=True, eq=False)
class EpisodeSample:
    """The arm and the pictures at one instant.

    Attributes:
        time_s: The time at which the sample was taken.
        read_s: The time at which the joints were read.
        measured: The measured joints (n,).
        reference: The set-points (n,); None if no control loop runs.
        pictures: The newest picture of each camera, as JPEG data.
    """

    time_s: float
    read_s: float
    measured: Vector
    reference: Vector | None
    pictures: tuple[bytes, ...]


class EpisodePanel:
    """Begins, saves and discards episodes.

    The arm is sampled in a separate thread.

    Args:
        arm_thread: Owns the arm.
        clock: The clock of the page.
        place: The data set.
        cameras: The cameras of the arm; every camera is recorded.
        exits: Stack that saves a running episode at the end.

    Raises:
        IkservoError: The data set cannot be continued, or a camera cannot be opened.
    """

    def __init__(
        self,
        arm_thread: ArmThread,
        clock: Clock,
        place: EpisodeFolder,
        cameras: ArmCameras | None,
        exits: ExitStack,
    ) -> None:
        self._arm_thread, self._clock = arm_thread, clock
        self._values = JointValues(arm_thread.arm.model)
        videos = cameras.open_all() if cameras is not None else {}
        self._videos = {camera_feature(title): video for title, video in videos.items()}
        self._writer = DatasetWriter(
            place.folder, arm_thread.arm.model, FPS, place.task, list(self._videos)
        )
        for video in self._videos.values():
            exits.enter_context(video.watched(1.0 / FPS))
        exits.callback(self._finish)
        self._samples: list[EpisodeSample] = []
        self._state, self._text = "idle", ""
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    def handle(self, message: RecordEpisode) -> None:
        """Begin an episode, or save or discard the one that was recorded.

        Raises:
            InputError: There is nothing to save, an episode is being recorded already, or a camera
                delivers no pictures.
        """
        if message.action == "begin":
            self._begin()
            return
        if self._state not in ("recording", "ended"):
            raise InputError("No episode is being recorded.")
        self._end_sampling()
        if message.action == "discard":
            self._state, self._text, self._samples = "idle", "", []
        elif not self._samples:
            raise InputError("The episode has no frames.", "Discard it.")
        else:
            self._state, self._text = "saving", ""
            self._thread = threading.Thread(target=self._save, name="ikservo episode", daemon=True)
            self._thread.start()

    def frames(self, client: Client) -> list[Frame]:
        """Return the new state of the recording for a client."""
        duration_s = self._samples[-1].time_s - self._samples[0].time_s if self._samples else 0.0
        fields: Frame = {
            "kind": "episode",
            "state": self._state,
            "seconds": math.floor(duration_s),
            "episodes": self._writer.episodes,
            "text": self._text,
        }
        if client.sent.get("episode") == fields:
            return []
        client.sent["episode"] = fields
        return [fields]

    def _begin(self) -> None:
        if self._state != "idle":
            raise InputError("An episode is being recorded.", "Save or discard it first.")
        for name, video in self._videos.items():
            if not video.is_fresh:
                raise InputError(
                    f"Camera {name} delivers no pictures.", video.trouble or "Try again."
                )
        self._state, self._text, self._samples = "recording", "", []
        self._ended.clear()
        self._thread = threading.Thread(target=self._run, name="ikservo episode", daemon=True)
        self._thread.start()

    def _end_sampling(self) -> None:
        self._ended.set()
        if self._thread is not None:
            self._thread.join()

    def _run(self) -> None:
        """Take a sample per frame until the episode ends."""
        picture_bytes = 0
        for elapsed_s in Rate(self._clock, 1.0 / FPS):
            if self._ended.is_set():
                return
            reason = self._reason_to_end()
            if elapsed_s > _LONGEST_S or picture_bytes > _MOST_PICTURE_BYTES:
                reason = "The episode has reached its greatest length."
            if reason:
                self._state, self._text = "ended", reason
                return
            now_s, snapshot = self._clock.now_s(), self._arm_thread.snapshot
            pictures = tuple(video.jpeg for video in self._videos.values())
            picture_bytes += sum(map(len, pictures))
            self._samples.append(
                EpisodeSample(
                    now_s, snapshot.read_s, snapshot.measured, snapshot.reference, pictures
                )
            )

    def _reason_to_end(self) -> str:
        """Return why an episode cannot go on; empty if it can."""
        snapshot = self._arm_thread.snapshot
        if snapshot.stop_notice:
            return "The arm was stopped."
        if self._arm_thread.lease.holder is None:
            return "The page in control was closed."
        if self._clock.now_s() - snapshot.read_s > _OLD_S:
            return "The arm does not answer."
        if not all(video.is_fresh for video in self._videos.values()):
            return "A camera delivers no pictures any more."
        return ""

    def _save(self) -> None:
        """Write the episode; if that fails, it can be saved again."""
        try:
            self._writer.add([resample(self._samples, self._values, list(self._videos))])
        except IkservoError as error:
            self._state, self._text = "ended", f"{error.message} {error.hint}".strip()
        else:
            self._samples = []
            self._state, self._text = "idle", f"Episode {self._writer.episodes - 1} is saved."

    def _finish(self) -> None:
        """Save what was recorded when the arm is closed."""
        if self._state in ("recording", "ended"):
            self._end_sampling()
            if self._samples:
                self._save()
        elif self._thread is not None:
            self._thread.join()


def resample(
    samples: Sequence[EpisodeSample], values: JointValues, cameras: Sequence[str] = ()
) -> NewEpisode:
    """Convert samples to an episode at the rate of the data set.

    Joints and set-points are interpolated between the times at which they were read; each frame
    has the newest picture before it. The action is the set-point; without a control loop, it is the
    joint positions in the next frame.
    """
    begin_s, end_s = samples[0].time_s, samples[-1].time_s
    grid_s = begin_s + np.arange(1 + int((end_s - begin_s) * FPS + 1e-6)) / FPS
    read = [samples[0]]
    for sample in samples[1:]:
        if sample.read_s > read[-1].read_s:
            read.append(sample)
    read_s = np.array([sample.read_s for sample in read])
    state = rows_at(grid_s, read_s, np.array([sample.measured for sample in read]))
    action = np.concatenate([state[1:], state[-1:]])
    driven = [sample for sample in read if sample.reference is not None]
    if driven:
        driven_s = np.array([sample.read_s for sample in driven])
        set_points = np.array([sample.reference for sample in driven], dtype=np.float64)
        newest = np.maximum(np.searchsorted(read_s, grid_s, side="right") - 1, 0)
        is_driven = np.array([sample.reference is not None for sample in read])[newest]
        set_points = rows_at(grid_s, driven_s, set_points)
        action = np.where(is_driven[:, None], set_points, action)
    times_s = np.array([sample.time_s for sample in samples])
    shown = [samples[int(k)] for k in np.searchsorted(times_s, grid_s + 1e-9, side="right") - 1]
    pictures = {name: [each.pictures[i] for each in shown] for i, name in enumerate(cameras)}
    return NewEpisode(
        values.rows_from_positions(state), values.rows_from_positions(action), pictures
    )


def camera_feature(title: str) -> str:
    """Return the name of a camera in a data set, such as ``camera_0``."""
    return re.sub(r"[^A-Za-z0-9]+", "_", title).strip("_").lower() or "camera"
