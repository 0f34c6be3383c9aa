"""Write recordings and episodes as a LeRobotDataset (version 3), as LeRobot reads it."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from ikservo.apps.teaching.dataset_reading import require_pyarrow
from ikservo.apps.teaching.lerobot_values import JointValues
from ikservo.apps.teaching.recording import Recording
from ikservo.errors import BadValueError, FileFormatError, InputError
from ikservo.files.reading import parse_json, read_text
from ikservo.files.writing import write_all_atomic
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.model import Model

if TYPE_CHECKING:
    import pyarrow as pa

_CHUNK = "chunk-000/file-000.parquet"
_PATTERN = "chunk-{chunk_index:03d}/file-{file_index:03d}"
_FILES_PER_CHUNK = 1000
_JOINTS = ("observation.state", "action")
_COUNTERS = ("frame_index", "episode_index", "index", "task_index")
_QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
_MAX_BYTES = 16 * 1024 * 1024  # of a metadata file that is continued
_BLOCK = 10  # frames that are written at once: larger blocks delay the control loop
_SAMPLED_PICTURES = 20  # per episode and camera, for the statistics
_PIXEL_STEP = 8  # every eighth row and column of them

Frames = dict[str, Matrix]
"""The columns of one episode, each (k, width)."""
Pictures = Mapping[str, Callable[[int], bytes]]
"""For each camera, a function that returns the JPEG data of a frame."""
Row = dict[str, Any]
"""The metadata of one episode."""


@dataclass(frozen=True, slots=True, eq=False)
class NewEpisode:
    """An episode to be added.

    Attributes:
        state: The measured values of the joints (k, n), in LeRobot's units.
        action: The commanded values (k, n).
        pictures: The pictures of the frames; without cameras, empty.
    """

    state: Matrix
    action: Matrix
    pictures: Pictures = field(default_factory=dict[str, "Callable[[int], bytes]"])


class DatasetWriter:
    """Writer of episodes to a data set: a new one, or one that was written for the same arm.

    Args:
        folder: The folder of the data set.
        model: The arm.
        fps: Frames per second.
        task: The task of the episodes that are added.
        cameras: The names of the cameras whose pictures each episode has.

    Raises:
        InputError: pyarrow is not installed, or the folder has other content.
        FileFormatError: The data set is damaged, or differs in joints, cameras or rate.
    """

    def __init__(
        self, folder: Path, model: Model, fps: int, task: str, cameras: Sequence[str] = ()
    ) -> None:
        require_pyarrow()
        self.folder, self.fps, self._task, self._arm = folder, fps, task, model.name
        self._cameras = {f"observation.images.{name}": name for name in cameras}
        self._names = list(JointValues(model).features)
        self._features: dict[str, Any] | None = None
        self._rows: list[Row] = []
        self._tasks: list[str] = []
        self._info: bytes | None = None  # the content of info.json
        if (folder / "meta" / "info.json").is_file():
            self._read_existing()
        elif folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise InputError(f"{folder} exists and is not a data set.", "Give a new folder.")

    @property
    def episodes(self) -> int:
        """The number of episodes."""
        return len(self._rows)

    @property
    def frames(self) -> int:
        """The number of frames of all episodes."""
        return self._rows[-1]["dataset_to_index"] if self._rows else 0

    def add(self, episodes: Sequence[NewEpisode]) -> None:
        """Write the episodes as one file of data, and the metadata of all episodes.

        Raises:
            InputError: The pictures differ in size from those in the data set, or another program
                has changed it.
            FileWriteError: A file cannot be written; the data set is as before.
        """
        if self._read_info() != self._info:
            raise InputError(f"{self.folder} was changed meanwhile.", "Record to a new folder.")
        features = self._feature_table(episodes[0])
        if self._features not in (None, features):
            raise InputError(
                "The pictures have another size than those in the data set.",
                "Record to a new folder, or set the camera as it was.",
            )
        tasks = [*self._tasks, *({self._task} - set(self._tasks))]
        file_index = 1 + self._rows[-1]["data/file_index"] if self._rows else 0
        chunk_index = self._rows[-1]["data/chunk_index"] if self._rows else 0
        chunk_index += file_index // _FILES_PER_CHUNK
        file_index %= _FILES_PER_CHUNK
        rows, parts = list(self._rows), list[tuple[Frames, Pictures]]()
        for episode in episodes:
            first = rows[-1]["dataset_to_index"] if rows else 0
            columns = _frames(episode, len(rows), first, self.fps, tasks.index(self._task))
            parts.append((columns, episode.pictures))
            row = self._episode_row(columns, episode.pictures)
            rows.append({**row, "data/chunk_index": chunk_index, "data/file_index": file_index})
        path = f"{_PATTERN}.parquet".format(chunk_index=chunk_index, file_index=file_index)
        data = {self.folder / "data" / path: partial(_write_data, parts)}
        metadata = self._metadata(rows, tasks, features)
        write_all_atomic({**data, **metadata})  # info.json last: without it, nothing counts
        self._rows, self._tasks, self._features = rows, tasks, features
        self._info = metadata[self.folder / "meta" / "info.json"]

    def _read_info(self) -> bytes | None:
        path = self.folder / "meta" / "info.json"
        return path.read_bytes() if path.is_file() else None

    def _read_existing(self) -> None:
        """Read the metadata of a data set that was written here."""
        import pyarrow.parquet as pq  # noqa: PLC0415  # from the extra `dataset`

        meta = self.folder / "meta"
        try:
            self._info = self._read_info()
            info: Any = parse_json(read_text(meta / "info.json", _MAX_BYTES))
            count, features = info["total_episodes"], info["features"]
            paths = sorted((meta / "episodes").rglob("*.parquet"))
            if sum(path.stat().st_size for path in [*paths, meta / "tasks.parquet"]) > _MAX_BYTES:
                raise ValueError("its metadata are too large")
            rows = [row for path in paths for row in pq.read_table(path).to_pylist()][:count]
            tasks = pq.read_table(meta / "tasks.parquet").to_pylist()
            tasks.sort(key=lambda row: row["task_index"])
            self._tasks = [str(row.get("task", row.get("__index_level_0__"))) for row in tasks]
            own = meta / "ikservo.json"
            found = {
                "frames": rows[-1]["dataset_to_index"],
                "files of episodes": len(paths),
                "frames per second": info["fps"],
                "robot": info["robot_type"],
                "joints": features["action"]["names"],
                "cameras": sorted(
                    key for key, each in features.items() if "image" in each["dtype"]
                ),
                "arm": parse_json(read_text(own, _MAX_BYTES))["arm"]
                if own.is_file()
                else self._arm,
            }
            total = info["total_frames"]
            if min(row["data/file_index"] for row in rows) < 0:
                raise ValueError("a file has a negative number")
            self._statistics_of(rows, features)
        except Exception as error:  # a damaged file may raise anything
            found = f"cannot be continued ({type(error).__name__}: {error})"
            raise FileFormatError(self.folder, "", found, "a data set of ikservo") from error
        cameras = sorted(self._cameras)
        wanted = (total, 1, self.fps, "ikservo", self._names, cameras, self._arm)
        for key, value in zip(found, wanted, strict=True):
            if found[key] != value:
                text = f"cannot be continued: its {key} are {found[key]}"
                raise FileFormatError(self.folder, "", text, f"{value}")
        self._rows, self._features = rows, features

    def _feature_table(self, episode: NewEpisode) -> dict[str, Any]:
        """Return LeRobot's description of the columns."""
        joints = {"dtype": "float32", "names": self._names, "shape": [len(self._names)]}
        single = {"shape": [1], "names": None}
        pictures = {
            key: {
                "dtype": "image",
                "shape": [*_decode(episode.pictures[name](0)).shape],
                "names": ["height", "width", "channels"],
            }
            for key, name in self._cameras.items()
        }
        return {
            **dict.fromkeys(_JOINTS, joints),
            **pictures,
            "timestamp": {"dtype": "float32", **single},
            **{key: {"dtype": "int64", **single} for key in _COUNTERS},
        }

    def _episode_row(self, frames: Frames, pictures: Pictures) -> Row:
        first, length = int(frames["index"][0, 0]), len(frames["index"])
        row: Row = {
            "episode_index": int(frames["episode_index"][0, 0]),
            "tasks": [self._task],
            "length": length,
            "dataset_from_index": first,
            "dataset_to_index": first + length,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
        }
        for key, column in frames.items():
            row |= {f"stats/{key}/{name}": x for name, x in _statistics(column).items()}
        for key, name in self._cameras.items():
            for what, values in _picture_statistics(pictures[name], length).items():
                row[f"stats/{key}/{what}"] = values
        return row

    def _metadata(
        self, rows: Sequence[Row], tasks: Sequence[str], features: dict[str, Any]
    ) -> dict[Path, bytes]:
        """Return the content of each file in ``meta``."""
        import pyarrow as pa  # noqa: PLC0415  # from the extra `dataset`

        table = pa.table({"task_index": [*range(len(tasks))], "task": tasks})
        indexed = table.replace_schema_metadata({"pandas": json.dumps(_INDEXED_BY_TASK)})
        statistics = self._statistics_of(rows, features)
        meta = self.folder / "meta"
        return {
            meta / "episodes" / _CHUNK: _parquet([pa.Table.from_pylist(list(rows))]),
            meta / "tasks.parquet": _parquet([indexed]),
            meta / "stats.json": _json(statistics),
            meta / "ikservo.json": _json({"arm": self._arm}),
            meta / "info.json": _json(_info(rows, len(tasks), features, self.fps)),
        }

    @staticmethod
    def _statistics_of(rows: Sequence[Row], features: Mapping[str, Any]) -> dict[str, Any]:
        """Combine the statistics of episodes; quantiles are averaged, as LeRobot does."""
        combined: dict[str, Any] = {}
        counts = np.array([row["stats/index/count"][0] for row in rows], dtype=np.float64)
        shares = counts / counts.sum()
        for key in features:
            values = {
                name: np.array([row[f"stats/{key}/{name}"] for row in rows], dtype=np.float64)
                for name in ("min", "max", "mean", "std", *_QUANTILES)
            }

            def mean(each: NDArray[np.float64]) -> NDArray[np.float64]:
                return np.asarray(np.tensordot(shares, each, axes=1), dtype=np.float64)

            spread = values["std"] ** 2 + (values["mean"] - mean(values["mean"])) ** 2
            combined[key] = {
                "min": values["min"].min(axis=0).tolist(),
                "max": values["max"].max(axis=0).tolist(),
                "mean": mean(values["mean"]).tolist(),
                "std": np.sqrt(mean(spread)).tolist(),
                "count": [int(counts.sum())],
                **{name: mean(values[name]).tolist() for name in _QUANTILES},
            }
        return combined


def write_dataset(
    folder: Path, model: Model, recordings: Sequence[Recording], fps: int | None, task: str
) -> int:
    """Write recordings as the episodes of a new data set; return the number of its frames.

    Each recording is sampled at ``fps``. The action of each frame is the joint positions in the
    next frame. The folder must be new or empty; without ``fps``, the rate of the first
    recording is used.

    Raises:
        InputError: pyarrow is not installed, or the folder is not empty.
        FileFormatError: A recording was made with another arm.
        FileWriteError: A file cannot be written; no files are kept.
    """
    require_pyarrow()
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder} exists.", "Give a new folder with --to.")
    fps = fps or round(1.0 / recordings[0].header.period_s)
    if not 1 <= fps <= 500:
        raise BadValueError("--fps", fps, "1 to 500 frames per second")
    values = JointValues(model)
    episodes: list[NewEpisode] = []
    for recording in recordings:
        if (recording.header.arm, recording.header.joints) != (model.name, values.names):
            found = f"has arm {recording.header.arm}, joints {', '.join(recording.header.joints)}"
            raise FileFormatError("The recording", "", found, f"arm {model.name}")
        begin_s, end_s = recording.times_s[[0, -1]]
        times_s = begin_s + np.arange(1 + int((end_s - begin_s) * fps + 1e-6)) / fps
        joints = values.rows_from_positions(rows_at(times_s, recording.times_s, recording.joints))
        episodes.append(NewEpisode(joints, np.concatenate([joints[1:], joints[-1:]])))
    writer = DatasetWriter(folder, model, fps, task)
    writer.add(episodes)
    return writer.frames


def rows_at(times_s: Vector, known_s: Vector, rows: Matrix) -> Matrix:
    """Interpolate rows (k, n) that are known at times (k,), increasing, to other times (m,)."""
    columns: list[Vector] = [np.interp(times_s, known_s, column) for column in rows.T]
    return np.stack(columns, axis=1)


def _frames(episode: NewEpisode, number: int, first: int, fps: int, task_index: int) -> Frames:
    count = np.arange(len(episode.state), dtype=np.float64)[:, None]
    return {
        "observation.state": episode.state,
        "action": episode.action,
        "timestamp": count / fps,
        "frame_index": count,
        "episode_index": np.full_like(count, number),
        "index": first + count,
        "task_index": np.full_like(count, task_index),
    }


def _parquet(tables: Sequence[pa.Table]) -> bytes:
    import pyarrow as pa  # noqa: PLC0415
    import pyarrow.parquet as pq  # noqa: PLC0415

    file = io.BytesIO()
    table = pa.concat_tables(tables)
    pq.write_table(table, file, compression="snappy")  # pyright: ignore[reportArgumentType]
    return file.getvalue()


def _write_data(parts: Sequence[tuple[Frames, Pictures]], file: BinaryIO) -> None:
    """Write the frames of episodes to a file, a few at a time."""
    import pyarrow.parquet as pq  # noqa: PLC0415

    with ExitStack() as exits:
        writer: pq.ParquetWriter | None = None
        for frames, pictures in parts:
            count = len(frames["index"])
            step = _BLOCK if pictures else count
            for first in range(0, count, step):
                table = _data_table(frames, pictures, range(first, min(first + step, count)))
                writer = writer or exits.enter_context(pq.ParquetWriter(file, table.schema))
                writer.write_table(table)


def _data_table(frames: Frames, pictures: Pictures, span: range) -> pa.Table:
    import pyarrow as pa  # noqa: PLC0415

    columns: dict[str, Any] = {}
    for key, whole in frames.items():
        rows = whole[span.start : span.stop]
        if key in _JOINTS:
            flat = pa.array(rows.astype(np.float32).ravel())
            columns[key] = pa.FixedSizeListArray.from_arrays(flat, rows.shape[1])
        else:
            kind = np.int64 if key in _COUNTERS else np.float32
            columns[key] = pa.array(rows[:, 0].astype(kind))
    for name, jpeg_of in pictures.items():
        data = pa.array([jpeg_of(frame) for frame in span], pa.binary())
        paths = pa.nulls(len(span), pa.string())
        columns[f"observation.images.{name}"] = pa.StructArray.from_arrays(
            [data, paths], ["bytes", "path"]
        )
    return pa.table(columns)


def _statistics(rows: Matrix) -> dict[str, list[float] | list[int]]:
    found: dict[str, list[float] | list[int]] = {
        "min": rows.min(axis=0).tolist(),
        "max": rows.max(axis=0).tolist(),
        "mean": rows.mean(axis=0).tolist(),
        "std": rows.std(axis=0).tolist(),
        "count": [len(rows)],
    }
    for name, share in _QUANTILES.items():
        found[name] = np.quantile(rows, share, axis=0).tolist()
    return found


def _picture_statistics(jpeg_of: Callable[[int], bytes], count: int) -> dict[str, Any]:
    """Return the statistics of the channels red, green and blue, 0 to 1, each (3, 1, 1)."""
    step = max(1, count // _SAMPLED_PICTURES)
    pixels = [
        _decode(jpeg_of(frame))[::_PIXEL_STEP, ::_PIXEL_STEP].reshape(-1, 3)
        for frame in range(0, count, step)
    ]
    found = _statistics(np.concatenate(pixels) / 255.0)
    shaped = {name: [[[x]] for x in values] for name, values in found.items() if name != "count"}
    return {**shaped, "count": [count]}


def _decode(jpeg: bytes) -> NDArray[np.uint8]:
    """Decode a picture as red, green and blue (h, w, 3)."""
    import cv2  # noqa: PLC0415  # from the extra `camera`

    image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    return cast("NDArray[np.uint8]", image)[:, :, ::-1]


def _info(rows: Sequence[Row], tasks: int, features: dict[str, Any], fps: int) -> dict[str, object]:
    return {
        "codebase_version": "v3.0",
        "robot_type": "ikservo",
        "fps": fps,
        "features": features,
        "total_episodes": len(rows),
        "total_frames": rows[-1]["dataset_to_index"],
        "total_tasks": tasks,
        "chunks_size": _FILES_PER_CHUNK,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "data_path": f"data/{_PATTERN}.parquet",
        "video_path": None,
        "splits": {"train": f"0:{len(rows)}"},
    }


def _json(table: Mapping[str, object]) -> bytes:
    return (json.dumps(table, indent=4) + "\n").encode()


# LeRobot reads the tasks with pandas and uses the sentence as the index.
_INDEXED_BY_TASK = {
    "index_columns": ["task"],
    "column_indexes": [],
    "columns": [
        {"name": "task_index", "field_name": "task_index", "pandas_type": "int64",
         "numpy_type": "int64", "metadata": None},
        {"name": "task", "field_name": "task", "pandas_type": "unicode",
         "numpy_type": "object", "metadata": None},
    ],
    "pandas_version": "2.0.0",
}  # fmt: skip
