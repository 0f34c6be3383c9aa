"""Read episodes of a LeRobotDataset (version 3) with pyarrow, without torch or LeRobot."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, cast

import numpy as np

from ikservo.errors import FileFormatError, IkservoError, InputError, UnknownNameError
from ikservo.files.reading import parse_json, read_text
from ikservo.kinematics.arrays import FrozenArrays, Matrix, Vector
from ikservo.remedies import install_command

COLUMNS: Mapping[str, str] = {"state": "observation.state", "action": "action"}
"""LeRobot's columns for the values of an episode: measured or commanded."""

_MAX_BYTES = 16 * 1024 * 1024
MAX_FRAMES = 1_000_000
"""Largest number of frames in a file; LeRobot starts a new file at 100 MB."""
_SUFFIX = ".pos"  # end of the name of a joint's value


@dataclass(frozen=True, slots=True, eq=False)
class Episode(FrozenArrays):
    """One episode.

    Attributes:
        number: The number of the episode in the data set.
        times_s: Times (k,) of the frames, increasing.
        values: The values of the joints (k, n), in LeRobot's units.
    """

    number: int
    times_s: Vector
    values: Matrix


@dataclass(frozen=True, slots=True)
class Dataset:
    """The metadata of a data set, and its episodes.

    Attributes:
        folder: The folder of the data set.
        robot_type: LeRobot's type of the robot.
        fps: Frames per second.
        joints: The names of the joints with values, without ``.pos``.
        episodes: All episodes.
    """

    folder: Path
    robot_type: str
    fps: int
    joints: tuple[str, ...]
    episodes: tuple[Episode, ...]


def require_pyarrow() -> None:
    """Check that pyarrow is installed.

    Raises:
        IkservoError: The package is not installed.
    """
    if find_spec("pyarrow") is None:
        raise IkservoError("Data sets need the package pyarrow, which is not installed.",
                           f"Install it: {install_command('dataset')}")  # fmt: skip


def read_dataset(folder: Path, what: str = "state") -> Dataset:
    """Read all episodes of a data set: measured (``state``) or commanded values (``action``).

    Raises:
        UnknownNameError: ``what`` is neither of the two.
        InputError: The folder has no data set.
        IkservoError: pyarrow is not installed.
        FileFormatError: The folder is not a data set of version 3, or has no joints.
    """
    if what not in COLUMNS:
        raise UnknownNameError("column", what, COLUMNS)
    path = folder / "meta" / "info.json"
    if not path.is_file():
        raise InputError(
            f"{folder} is not a LeRobotDataset: it has no meta/info.json.",
            "Give the folder that contains meta and data.",
        )
    info = _read_info(path)
    require_pyarrow()
    names = _value_names(path, info, COLUMNS[what])
    columns = [i for i, name in enumerate(names) if name.endswith(_SUFFIX)]
    if not columns:
        found = f"has no joints: {', '.join(names) or 'no names'}"
        raise FileFormatError(
            path, COLUMNS[what], found, "names such as elbow_flex.pos; try another --what"
        )
    joints = tuple(names[i].removesuffix(_SUFFIX) for i in columns)
    episodes = tuple(_read_episodes(folder, COLUMNS[what], columns, len(names)))
    fps = info["fps"]
    if not isinstance(fps, (int, float)) or isinstance(fps, bool) or not 0 < fps <= 500:
        raise FileFormatError(path, "fps", f"is {fps!r}", "frames per second, up to 500")
    return Dataset(folder, str(info.get("robot_type") or ""), round(fps), joints, episodes)


def _read_info(path: Path) -> dict[str, object]:
    try:
        info = parse_json(read_text(path, _MAX_BYTES))
    except (ValueError, RecursionError) as error:
        if isinstance(error, FileFormatError):
            raise
        raise FileFormatError(path, "", "is not JSON", "LeRobot's info.json") from error
    if not isinstance(info, dict) or not {"codebase_version", "features", "fps"} <= info.keys():
        raise FileFormatError(
            path, "", "is not from LeRobot", "keys codebase_version, features, fps"
        )
    version = cast("dict[str, object]", info)["codebase_version"]
    if not str(version).startswith("v3."):
        expected = "v3.0; LeRobot's convert_dataset_v21_to_v30 converts older data sets"
        raise FileFormatError(path, "codebase_version", f"is {version!r}", expected)
    return cast("dict[str, object]", info)


def _value_names(path: Path, info: Mapping[str, object], column: str) -> list[str]:
    features = info["features"]
    feature = features.get(column) if isinstance(features, dict) else None  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]
    names = feature.get("names") if isinstance(feature, dict) else None  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]
    if not isinstance(names, list):
        raise FileFormatError(path, f"features.{column}", "has no names", "a name for each value")
    return [str(name) for name in cast("Sequence[object]", names)]


def _read_episodes(folder: Path, column: str, columns: list[int], width: int) -> Iterator[Episode]:
    paths = sorted((folder / "data").glob("*/*.parquet"))
    if not paths:
        raise FileFormatError(folder / "data", "", "has no episodes", "chunk-000/file-000.parquet")
    parts = [_read_file(path, column, width) for path in paths]
    numbers, times_s, values = (np.concatenate(each) for each in zip(*parts, strict=True))
    for number in np.unique(numbers).tolist():
        rows = np.flatnonzero(numbers == number)
        rows = rows[np.argsort(times_s[rows], kind="stable")]
        episode = Episode(int(number), times_s[rows], values[rows][:, columns])
        where = f"episode {episode.number}"
        if not (np.isfinite(episode.values).all() and np.isfinite(episode.times_s).all()):
            raise FileFormatError(
                folder, where, "has values that are not numbers", "finite numbers"
            )
        if np.any(np.diff(episode.times_s) <= 0.0):
            raise FileFormatError(
                folder, where, "has two frames with the same time", "increasing timestamps"
            )
        yield episode


def _read_file(path: Path, column: str, width: int) -> tuple[Vector, Vector, Matrix]:
    """Read episode numbers (k,), times (k,) and values (k, width) from a file."""
    import pyarrow as pa  # noqa: PLC0415  # from the extra `dataset`

    pq: Any = importlib.import_module("pyarrow.parquet")  # its type hints are incomplete
    names = ["episode_index", "timestamp", column]
    try:
        _check_size(path, pq.ParquetFile(path), names, width)
        table: Any = pq.read_table(path, columns=names)
        flat: Any = table.column(column).combine_chunks().flatten().to_numpy(zero_copy_only=False)
        rows = flat.astype(np.float64).reshape(len(table), -1)
        numbers, times_s = (
            table.column(name).to_numpy().astype(np.float64)
            for name in ("episode_index", "timestamp")
        )
    except FileFormatError:
        raise
    except (OSError, KeyError, ValueError, TypeError, AttributeError, pa.ArrowException) as error:
        text = str(error).partition("\n")[0]
        raise FileFormatError(path, "", f"cannot be read: {text}", "LeRobot's frames") from error
    if rows.shape != (len(times_s), width):
        raise FileFormatError(path, column, f"has shape {rows.shape}", f"{width} values per frame")
    return numbers, times_s, rows


def _check_size(path: Path, file: Any, names: Sequence[str], width: int) -> None:  # noqa: ANN401  # no types
    """Refuse too many frames or values before any are read, because small files can expand."""
    metadata = file.metadata
    rows, values, size = metadata.num_rows, 0, 0
    for group in range(metadata.num_row_groups):
        for index in range(metadata.num_columns):
            part = metadata.row_group(group).column(index)
            if part.path_in_schema.startswith(tuple(names)):
                values, size = values + part.num_values, size + part.total_uncompressed_size
    if rows > MAX_FRAMES or values > (width + 2) * rows or size > 16 * (values + 1) + _MAX_BYTES:
        found = f"has {rows:,} frames of {values:,} values in {size:,} bytes"
        expected = f"at most {MAX_FRAMES:,} frames in a file, {width} values in each"
        raise FileFormatError(path, "", found, expected)
