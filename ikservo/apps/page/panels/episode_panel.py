"""Record the arm of a page, with its cameras, as episodes of a data set."""

from __future__ import annotations

import re
import tempfile
import threading
import weakref
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ikservo.apps.page.messages.page_messages import RecordEpisode
from ikservo.apps.page.panels.page_cameras import ArmCameras
from ikservo.apps.page.panels.video import VideoSource
from ikservo.apps.page.running.arm_thread import ArmThread
from ikservo.apps.page.server.message_age_and_rate import Client
from ikservo.apps.page.server.server import Frame
from ikservo.apps.teaching.dataset_writing import DatasetWriter, NewEpisode, rows_at
from ikservo.apps.teaching.lerobot_values import JointValues
from ikservo.cli.terminal import print_status
from ikservo.clock import Clock
from ikservo.errors import IkservoError, InputError
from ikservo.files.writing import make_folder
from ikservo.kinematics.arrays import Vector

FPS = 30
_OLD_S = 0.5  # an episode ends if the joints are older
_OLD_PICTURE_S = 2.0  # or a picture; a simulated camera is slow
_SILENT_S = 2.0  # an episode ends if the page in control is silent for longer
_CAMERAS_S = 5.0  # time for the cameras to deliver their first pictures
_LONGEST_S = 600.0


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
        set_point: The set-points (n,) of the servos; None if torque is off.
        pictures: The number of the newest picture of each camera among the stored ones.
    """

    time_s: float
    read_s: float
    measured: Vector
    set_point: Vector | None
    pictures: tuple[int, ...] = ()


class StoredPictures:
    """Pictures as JPEG data in a temporary file, because an episode may not fit into memory."""

    def __init__(self, folder: Path) -> None:
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115  # closed with the object
        weakref.finalize(self, self._file.close)
        self._ends = [0]

    def append(self, jpeg: bytes) -> int:
        """Store a picture; return its number."""
        self._file.seek(self._ends[-1])
        self._file.write(jpeg)
        self._ends.append(self._ends[-1] + len(jpeg))
        return len(self._ends) - 2

    def read(self, number: int) -> bytes:
        """Return a stored picture."""
        begin, end = self._ends[number : number + 2]
        self._file.seek(begin)
        return self._file.read(end - begin)


class EpisodePanel:
    """Begins, saves and discards episodes; the arm is sampled in a separate thread.

    Args:
        arm_thread: Owns the arm.
        clock: The clock of the page.
        place: The data set.
        cameras: The cameras of the arm; every camera is recorded.
        exits: Stack that saves a recorded episode when the arm is closed.

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
        self._arm_thread, self._clock, self._arm = arm_thread, clock, arm_thread.arm
        self._values = JointValues(self._arm.model)
        self._videos: dict[str, VideoSource] = {}
        for title, video in (cameras.open_all() if cameras is not None else {}).items():
            self._videos[_unused_name(camera_feature(title), self._videos)] = video
        self._writer = DatasetWriter(
            place.folder, self._arm.model, FPS, place.task, list(self._videos)
        )
        exits.callback(self._finish)
        self._samples: list[EpisodeSample] = []
        self._state, self._text = "idle", ""
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    def handle(self, message: RecordEpisode) -> None:
        """Begin an episode, or save or discard the recorded one.

        Raises:
            InputError: There is nothing to save, or the arm or the last episode is not ready.
        """
        if message.action == "begin":
            self._begin()
        elif self._state not in ("recording", "ended"):
            raise InputError("No episode is being recorded.")
        elif message.action == "discard":
            self._end_sampling()
            self._state, self._text, self._samples = "idle", "", []
        else:
            self._end_sampling()
            if not self._samples:
                raise InputError(f"{self._text} The episode has no frames.".strip(), "Discard it.")
            self._state, self._text = "saving", ""
            self._start(self._save)

    def frames(self, client: Client) -> list[Frame]:
        """Return the new state of the recording for a client."""
        samples = self._samples
        fields = {
            "kind": "episode",
            "state": self._state,
            "seconds": int(samples[-1].time_s - samples[0].time_s) if samples else 0,
            "episodes": self._writer.episodes,
            "text": self._text,
        }
        return client.unsent(fields)

    def _begin(self) -> None:
        if self._state != "idle":
            raise InputError("The last episode is not finished.", "Save or discard it first.")
        reason = self._reason_to_end()
        if reason:
            raise InputError(reason, "Nothing is recorded.")
        make_folder(self._writer.folder)
        self._state, self._text, self._samples = "recording", "", []
        self._ended.clear()
        self._start(self._record)

    def _start(self, work: Callable[[], None]) -> None:
        self._thread = threading.Thread(target=work, name="ikservo episode", daemon=True)
        self._thread.start()

    def _end_sampling(self) -> None:
        self._ended.set()
        if self._thread is not None:
            self._thread.join()

    def _record(self) -> None:
        """Sample the arm until the episode ends; cameras are read only meanwhile."""
        with ExitStack() as exits:
            for video in self._videos.values():
                exits.enter_context(video.watched(1.0 / FPS))
            try:
                folder = self._writer.folder
                self._pictures = {name: StoredPictures(folder) for name in self._videos}
                reason = self._wait_for_cameras() or self._sample_until_end()
            except OSError as error:
                reason = f"Pictures cannot be stored: {error.strerror}."
        if reason:
            self._state, self._text = "ended", reason

    def _wait_for_cameras(self) -> str:
        """Wait for a new picture of each camera; return why one is missing, or an empty text."""
        begin_s, waited_s = self._clock.now_s(), 0.0
        while missing := [each for each in self._videos.values() if each.age_s() >= waited_s]:
            waited_s = self._clock.now_s() - begin_s
            if waited_s > _CAMERAS_S:
                return missing[0].trouble or f"No picture from {missing[0].name}."
            if self._ended.wait(1.0 / FPS):
                break
        self._series = [video.series for video in self._videos.values()]
        return ""

    def _sample_until_end(self) -> str:
        """Take a sample per frame until the episode ends; return why it cannot go on."""
        start_s = self._clock.now_s()
        newest = dict.fromkeys(self._videos, -1)  # numbers of the cameras' pictures
        stored = dict.fromkeys(self._videos, 0)
        while not self._ended.is_set():
            now_s, snapshot = self._clock.now_s(), self._arm_thread.snapshot
            reason = self._reason_to_end() or self._camera_problem()
            if reason or now_s - start_s > _LONGEST_S:
                return reason or f"An episode lasts {_LONGEST_S:.0f} s at most."
            for name, video in self._videos.items():
                picture = video.picture
                if picture is not None and picture.number != newest[name]:
                    newest[name] = picture.number
                    stored[name] = self._pictures[name].append(picture.jpeg)
            torque = any(state.torque for state in snapshot.states)
            reference = snapshot.start if snapshot.reference is None else snapshot.reference
            self._samples.append(
                EpisodeSample(
                    now_s, snapshot.read_s, snapshot.measured, reference if torque else None,
                    tuple(stored.values()),
                )
            )  # fmt: skip
            due_s = start_s + len(self._samples) / FPS
            self._ended.wait(max(0.0, due_s - self._clock.now_s()))
        return ""

    def _reason_to_end(self) -> str:
        """Return why an episode cannot begin or go on; empty if it can."""
        snapshot, lease = self._arm_thread.snapshot, self._arm_thread.lease
        if snapshot.stop_notice:
            return "The arm is stopped."
        if snapshot.calibration or self._arm_thread.arm is not self._arm:
            self._arm = self._arm_thread.arm
            return "The arm was calibrated or opened again."
        if lease.holder is None or lease.silence_s() > _SILENT_S:
            return "No page controls the arm."
        if self._clock.now_s() - snapshot.read_s > _OLD_S:
            return "The arm does not answer."
        return ""

    def _camera_problem(self) -> str:
        for video, series in zip(self._videos.values(), self._series, strict=True):
            if video.age_s() > _OLD_PICTURE_S:
                return f"No picture from {video.name} any more."
            if video.series != series:
                return f"{video.name} was interrupted, or its pictures changed their size."
        return ""

    def _save(self) -> None:
        """Write the episode; if that fails, it can be saved again."""
        try:
            self._write()
        except Exception as error:  # whatever it is, the episode must not be lost
            ours = isinstance(error, IkservoError)
            text = f"{error.message} {error.hint}" if ours else f"It cannot be saved: {error!r}."
            self._state, self._text = "ended", text.strip()

    def _write(self) -> None:
        self._writer.add([resample(self._samples, self._values, self._pictures)])
        self._samples = []
        self._state, self._text = "idle", ""

    def _finish(self) -> None:
        """Save what was recorded when the arm is closed.

        Raises:
            IkservoError: The episode cannot be saved.
        """
        self._end_sampling()
        if self._samples:
            print_status(f"Saving the recorded episode to {self._writer.folder} …")
            self._write()


def resample(
    samples: Sequence[EpisodeSample],
    values: JointValues,
    stored: Mapping[str, StoredPictures] | None = None,
) -> NewEpisode:
    """Convert samples to an episode at the rate of the data set.

    Joints and set-points are interpolated between the times at which they were read; each frame
    has the pictures of the nearest sample. The action is the set-point; for a limp arm, it is the
    joints of the next frame.

    Args:
        samples: The samples, at about this rate.
        values: The values of the joints.
        stored: The pictures of each camera, by the numbers in the samples.
    """
    times_s = [sample.time_s for sample in samples]
    count = 1 + int((times_s[-1] - times_s[0]) * FPS + 0.5)
    grid_s = times_s[0] + np.arange(count) / FPS
    nearest = [bisect_right(times_s, at_s + 0.5 / FPS) - 1 for at_s in grid_s.tolist()]
    read = [samples[0]]
    for sample in samples[1:]:
        if sample.read_s > read[-1].read_s:
            read.append(sample)
    read_s = np.array([sample.read_s for sample in read])
    state = rows_at(grid_s, read_s, np.array([sample.measured for sample in read]))
    action = np.concatenate([state[1:], state[-1:]])
    driven = [sample for sample in read if sample.set_point is not None]
    if driven:
        set_points = np.array([sample.set_point for sample in driven], dtype=np.float64)
        set_points = rows_at(grid_s, np.array([sample.read_s for sample in driven]), set_points)
        is_driven = [samples[k].set_point is not None for k in nearest]
        action = np.where(np.array(is_driven)[:, None], set_points, action)

    def reader(i: int, pictures: StoredPictures) -> Callable[[int], bytes]:
        return lambda frame: pictures.read(samples[nearest[frame]].pictures[i])

    pictures = {name: reader(i, each) for i, (name, each) in enumerate((stored or {}).items())}
    return NewEpisode(
        values.rows_from_positions(state), values.rows_from_positions(action), pictures
    )


def camera_feature(title: str) -> str:
    """Return the name of a camera in a data set, such as ``camera_0``."""
    return re.sub(r"[^A-Za-z0-9]+", "_", title).strip("_").lower() or "camera"


def _unused_name(name: str, used: Mapping[str, object]) -> str:
    while name in used:
        name += "_2"
    return name
