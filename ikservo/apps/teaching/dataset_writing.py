"""Write recordings as a LeRobotDataset (version 3) with the files that LeRobot reads."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ikservo.apps.teaching.dataset_reading import require_pyarrow
from ikservo.apps.teaching.lerobot_values import JointValues
from ikservo.apps.teaching.recording import Recording
from ikservo.errors import BadValueError, FileFormatError, InputError
from ikservo.files.writing import write_all_atomic
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.model import Model

if TYPE_CHECKING:
    import pyarrow as pa

_CHUNK = "chunk-000/file-000.parquet"
_PATTERN = "chunk-{chunk_index:03d}/file-{file_index:03d}"
_JOINTS = ("observation.state", "action")
_COUNTERS = ("frame_index", "episode_index", "index", "task_index")
_QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}

Frames = dict[str, Matrix]
"""The columns of one episode, each (k, width)."""


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
    episodes: list[Frames] = []
    for recording in recordings:
        if (recording.header.arm, recording.header.joints) != (model.name, values.names):
            found = f"has arm {recording.header.arm}, joints {', '.join(recording.header.joints)}"
            raise FileFormatError("The recording", "", found, f"arm {model.name}")
        begin_s, end_s = recording.times_s[[0, -1]]
        times_s = begin_s + np.arange(1 + int((end_s - begin_s) * fps + 1e-6)) / fps
        columns: list[Vector] = [
            np.interp(times_s, recording.times_s, column) for column in recording.joints.T
        ]
        joints = values.rows_from_positions(np.stack(columns, axis=1))
        first = sum(len(each["index"]) for each in episodes)
        episodes.append(_frames(joints, len(episodes), first, fps))
    write_all_atomic(_files(folder, list(values.features), episodes, fps, task))
    return sum(len(each["index"]) for each in episodes)


def _frames(joints: Matrix, number: int, first: int, fps: int) -> Frames:
    count = np.arange(len(joints), dtype=np.float64)[:, None]
    return {
        "observation.state": joints,
        "action": np.concatenate([joints[1:], joints[-1:]]),
        "timestamp": count / fps,
        "frame_index": count,
        "episode_index": np.full_like(count, number),
        "index": first + count,
        "task_index": np.zeros_like(count),
    }


def _files(
    folder: Path, names: list[str], episodes: Sequence[Frames], fps: int, task: str
) -> dict[Path, bytes]:
    """Return the content of each file of a data set."""
    import pyarrow as pa  # noqa: PLC0415  # from the extra `dataset`

    whole = {key: np.concatenate([each[key] for each in episodes]) for key in episodes[0]}
    tasks = pa.table({"task_index": [0], "task": [task]}).replace_schema_metadata(
        {"pandas": json.dumps(_INDEXED_BY_TASK)}
    )
    info = _info(names, episodes, len(whole["index"]), fps)
    return {
        folder / "data" / _CHUNK: _parquet(_data_table(whole, len(names))),
        folder / "meta" / "episodes" / _CHUNK: _parquet(
            pa.Table.from_pylist(
                [_episode_row(number, frames, task) for number, frames in enumerate(episodes)]
            )
        ),
        folder / "meta" / "tasks.parquet": _parquet(tasks),
        folder / "meta" / "stats.json": _json(
            {key: _statistics(column) for key, column in whole.items()}
        ),
        folder / "meta" / "info.json": _json(info),
    }


def _parquet(table: pa.Table) -> bytes:
    import pyarrow.parquet as pq  # noqa: PLC0415

    file = io.BytesIO()
    pq.write_table(table, file, compression="snappy")  # pyright: ignore[reportArgumentType]
    return file.getvalue()


def _data_table(whole: Frames, width: int) -> pa.Table:
    import pyarrow as pa  # noqa: PLC0415

    columns: dict[str, Any] = {}
    for key, rows in whole.items():
        if key in _JOINTS:
            flat = pa.array(rows.astype(np.float32).ravel())
            columns[key] = pa.FixedSizeListArray.from_arrays(flat, width)
        else:
            kind = np.int64 if key in _COUNTERS else np.float32
            columns[key] = pa.array(rows[:, 0].astype(kind))
    return pa.table(columns)


def _episode_row(number: int, frames: Frames, task: str) -> dict[str, object]:
    first, length = int(frames["index"][0, 0]), len(frames["index"])
    row: dict[str, object] = {
        "episode_index": number,
        "tasks": [task],
        "length": length,
        "data/chunk_index": 0,
        "data/file_index": 0,
        "dataset_from_index": first,
        "dataset_to_index": first + length,
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
    }
    for key, column in frames.items():
        for name, value in _statistics(column).items():
            row[f"stats/{key}/{name}"] = value
    return row


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


def _info(names: list[str], episodes: Sequence[Frames], frames: int, fps: int) -> dict[str, object]:
    joints = {"dtype": "float32", "names": names, "shape": [len(names)]}
    single = {"shape": [1], "names": None}
    return {
        "codebase_version": "v3.0",
        "robot_type": "ikservo",
        "fps": fps,
        "features": {
            **dict.fromkeys(_JOINTS, joints),
            "timestamp": {"dtype": "float32", **single},
            **{key: {"dtype": "int64", **single} for key in _COUNTERS},
        },
        "total_episodes": len(episodes),
        "total_frames": frames,
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "data_path": f"data/{_PATTERN}.parquet",
        "video_path": None,
        "splits": {"train": f"0:{len(episodes)}"},
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
