"""Recordings of joint positions as JSON lines: format, writer and reader.

::

    {"schema": "ikservo/recording/1", "arm": "so101", "joints": ["shoulder_pan", …],
     "units": ["rad", …], "period_s": 0.02}
    {"t_s": 0.0, "q": [0.0123, …]}
    {"t_s": 0.02, "q": [0.0123, …]}

Each line is flushed when it is written, so that an interrupted recording keeps its samples; an
incomplete or malformed line is refused, and the error gives its number.
"""

from __future__ import annotations

import contextlib
import json
import math
from array import array
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, cast

import numpy as np

from ikservo.arguments import check_flag
from ikservo.control.joint_reading import JointState
from ikservo.errors import FileFormatError, InputError
from ikservo.files.reading import parse_json, require_file
from ikservo.files.writing import FileWriteError
from ikservo.kinematics.arrays import FrozenArrays, Matrix, Vector
from ikservo.motion.sampled_trajectory import SampledTrajectory

SCHEMA = "ikservo/recording/1"
_PLACES = 6  # decimals of rad or m: a hundredth of a tick


@dataclass(frozen=True, slots=True)
class RecordingHeader:
    """Description of the columns of a recording.

    Attributes:
        arm: The arm's name; empty if another program made the recording.
        joints: The name of each column.
        units: ``rad`` or ``m`` per column; ``rad_or_m`` if another program made it.
        period_s: The nominal time between two samples.
    """

    arm: str
    joints: tuple[str, ...]
    units: tuple[str, ...]
    period_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Recording(FrozenArrays):
    """A recording that was read from a file.

    Attributes:
        header: The description of the columns.
        times_s: Times (k,) of the samples, increasing.
        joints: The joints (k, n) at these times, rad or m.
        first_line: The line number of the first sample; None if the file is not a text file.
    """

    header: RecordingHeader
    times_s: Vector
    joints: Matrix
    first_line: int | None = 2

    def place(self, index: int | None) -> str:
        """Return the place of a sample in the file, or of the header for None."""
        if self.first_line is None:
            return "its arm" if index is None else f"sample {index + 1}"
        return f"line {1 if index is None else self.first_line + index}"

    def trajectory(self) -> SampledTrajectory:
        """Return the samples as a trajectory; velocities are differences of the positions."""
        moving = len(self.times_s) > 1
        velocities = np.gradient(self.joints, self.times_s, axis=0) if moving else 0.0 * self.joints
        header = self.header
        return SampledTrajectory(header.joints, header.units, self.times_s, self.joints, velocities)

    def to_csv(self, path: Path | str | None = None, *, overwrite: bool = False) -> str:
        """Format the recording as CSV, and write it to a file if a path is given.

        Raises:
            InputError: The file exists and ``overwrite`` is false.
            FileWriteError: The file cannot be written.
        """
        return self.trajectory().to_csv(path, overwrite=overwrite)

    def __repr__(self) -> str:
        """Show the number of samples, the duration and the arm."""
        last_s = float(self.times_s[-1]) if len(self.times_s) else 0.0
        return f"Recording({len(self.times_s)} samples in {last_s:.3f} s of {self.header.arm})"


@dataclass(frozen=True, slots=True, eq=False)
class ArmSample(FrozenArrays):
    """The state of an arm at one instant.

    Attributes:
        positions: The measured joints (n,), rad or m.
        goals: The servos' goals (n,); None if they have none.
        states: The health of each joint; empty if it was not read in this sample.
        stopped_for: The reason why the arm is stopped; empty if it is not stopped or unknown.
    """

    positions: Vector
    goals: Vector | None = None
    states: tuple[JointState, ...] = ()
    stopped_for: str = ""

    @classmethod
    def of_states(cls, states: tuple[JointState, ...]) -> ArmSample:
        """Make a sample from the states of all joints."""
        goals = [state.goal_rad for state in states]
        return cls(
            np.array([state.position_rad for state in states]),
            None if None in goals else np.array(goals, dtype=np.float64),
            states,
        )


class RecordingWriter:
    """Writer of a recording, line by line.

    Args:
        path: A new file.
        header: The description of the columns.
        overwrite: Whether an existing file may be replaced.

    Raises:
        InputError: The file exists and ``overwrite`` is false.
        FileWriteError: The file cannot be written.
    """

    def __init__(
        self, path: Path | str, header: RecordingHeader, *, overwrite: bool = False
    ) -> None:
        self.path, self.samples = Path(path), 0
        self._target = RecordingFile(self.path, overwrite=overwrite)
        self._whole_bytes = 0
        with self._target.removing_on_error():
            self._write_row({"schema": SCHEMA, "arm": header.arm, "joints": header.joints,
                       "units": header.units, "period_s": header.period_s})  # fmt: skip

    def write(self, time_s: float, joints: Vector) -> None:
        """Write one sample: seconds since the first, and the joints (n,), rad or m.

        Raises:
            FileWriteError: The disk is full or not writable.
        """
        q = [round(float(x), _PLACES) for x in joints]
        self._write_row({"t_s": round(time_s, _PLACES), "q": q})
        self.samples += 1

    def write_sample(self, time_s: float, sample: ArmSample) -> None:
        """Write the positions of one sample; see ``write``."""
        self.write(time_s, sample.positions)

    def close(self) -> None:
        """Close the file, which then replaces an existing file.

        Raises:
            FileWriteError: The disk is not writable.
        """
        self._target.finish()

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _write_row(self, row: dict[str, object]) -> None:
        left = memoryview(json.dumps(row, allow_nan=False).encode() + b"\n")
        size = len(left)
        try:
            while left:
                left = left[self._target.file.write(left) :]
        except OSError as error:
            with contextlib.suppress(OSError):  # replay refuses an incomplete line
                self._target.file.truncate(self._whole_bytes)
            raise self._target.failed(error) from error
        self._whole_bytes += size


class RecordingFile:
    """A file for a recording; a replacement is written next to the old file and renamed at the end.

    Args:
        path: The file.
        overwrite: Whether an existing file may be replaced.

    Attributes:
        file: The file that is written; unbuffered.

    Raises:
        InputError: The file exists and ``overwrite`` is false.
        FileWriteError: The file cannot be written.
    """

    def __init__(self, path: Path, *, overwrite: bool) -> None:
        self._path, self._has_failed = path, False
        try:
            self._replaces = check_flag("overwrite", overwrite) and path.is_file()
            self._written = path.with_name(f"{path.name}.part") if self._replaces else path
            self.file: IO[Any] = self._written.open("wb" if overwrite else "xb", buffering=0)
        except FileExistsError:
            raise InputError(f"File {path} exists; use --overwrite.") from None
        except (OSError, ValueError) as error:
            raise FileWriteError(path, os_error_text(error)) from error

    def failed(self, error: OSError) -> FileWriteError:
        """Return the error that names the incomplete recording; the old file is kept."""
        self._has_failed = True
        kept = f"The samples recorded so far are in {self._written}"
        if self._replaces:
            kept = f"The existing file is unchanged. {kept}"
        return FileWriteError(self._path, os_error_text(error), kept=kept)

    def finish(self) -> None:
        """Close the file; if it is complete, it replaces the existing file.

        Raises:
            FileWriteError: The file cannot be replaced.
        """
        try:
            self.file.close()
            if self._replaces and not self._has_failed:
                self._written.replace(self._path)
        except OSError as error:
            raise self.failed(error) from error

    @contextlib.contextmanager
    def removing_on_error(self) -> Generator[None]:
        """Remove the file, which has no samples yet, if its header cannot be written.

        Raises:
            FileWriteError: The header cannot be written.
        """
        try:
            yield
        except BaseException as error:
            with contextlib.suppress(OSError):
                self.file.close()
                if self._written.is_file():  # devices are not removed
                    self._written.resolve().unlink()
            if isinstance(error, FileWriteError):
                raise FileWriteError(self._path, error.why) from error
            raise


def os_error_text(error: OSError | ValueError) -> str:
    """Return the system's message for an error, or else the text of the error."""
    return (error.strerror if isinstance(error, OSError) else "") or str(error)


_MAX_LINE_CHARS = 16_384
MAX_SECONDS = 20_000.0
MAX_SAMPLES = 2_000_000  # over five hours at 100 Hz
MAX_JOINTS = 100
_KEYS = {"schema", "arm", "joints", "units", "period_s"}


def read_json_lines(path: Path) -> Recording:
    """Read a recording of JSON lines.

    Raises:
        FileFormatError: The file cannot be read, or a line is malformed; the message names it.
    """
    lines = _read_lines(path)
    row = _parse_object(path, 1, next(lines, "") or "\n")
    if row.get("schema") != SCHEMA:
        raise _recording_error(path, 1, "is not the header of a recording", f'"schema": "{SCHEMA}"')
    if row.keys() != _KEYS:
        odd = ", ".join(sorted(row.keys() ^ _KEYS))
        raise _recording_error(
            path, 1, f"has missing or unknown keys: {odd}", f"the keys {', '.join(sorted(_KEYS))}"
        )
    header = check_header(path, "line 1", row)
    times_s, joints = array("d"), array("d")  # lists would need three times the memory
    for number, line in enumerate(lines, start=2):
        time_s, q = _parse_sample(path, number, line, len(header.joints))
        if times_s and time_s <= times_s[-1]:
            raise _recording_error(
                path, number, f"has t_s = {time_s:g}", "a later time than the line before"
            )
        if len(times_s) >= MAX_SAMPLES:
            raise _recording_error(
                path, number, "is one sample too many", f"at most {MAX_SAMPLES} samples"
            )
        times_s.append(time_s)
        joints.extend(q)
    if not times_s:
        raise FileFormatError(path, "", "has no sample", "at least one line after the header")
    return Recording(header, np.array(times_s), np.array(joints).reshape(len(times_s), -1))


def _read_lines(path: Path) -> Iterator[str]:
    require_file(path)
    try:
        with path.open("rb") as file:
            number = 0
            while line := file.readline(_MAX_LINE_CHARS + 1):
                number += 1
                yield _require_complete_line(path, number, line)
    except OSError as error:
        raise FileFormatError(path, "", f"cannot be read ({error.strerror})") from error
    except ValueError as error:
        if isinstance(error, FileFormatError):
            raise
        raise FileFormatError(path, "", "cannot be a path") from error


def _require_complete_line(path: Path, number: int, line: bytes) -> str:
    if len(line) > _MAX_LINE_CHARS:
        raise _recording_error(path, number, "is too long", f"at most {_MAX_LINE_CHARS} bytes")
    if not line.endswith(b"\n"):
        raise _recording_error(
            path, number, "is incomplete", "a complete line; delete this one to use the others"
        )
    try:
        return line.decode()
    except UnicodeDecodeError:
        raise _recording_error(path, number, "is not text in UTF-8", "JSON") from None


def check_header(path: Path, where: str, row: Mapping[str, object]) -> RecordingHeader:
    """Check arm, joints, units and period_s of the header.

    Raises:
        FileFormatError: A value is missing, or cannot be used.
    """
    arm, joints, units = row.get("arm"), _text_tuple(row.get("joints")), row.get("units")
    if len(joints) > MAX_JOINTS:
        raise FileFormatError(path, where, f"has {len(joints)} joints", f"at most {MAX_JOINTS}")
    if not (isinstance(arm, str) and joints and len(set(joints)) == len(joints)):
        raise FileFormatError(
            path, where, "has no arm or joints", "the arm's name and each joint once"
        )
    units = _text_tuple(units)
    if len(units) != len(joints) or not set(units) <= {"rad", "m"}:
        raise FileFormatError(path, where, "has wrong units", '"rad" or "m" for each joint')
    period_s = _finite_number(row.get("period_s"))
    if period_s is None or not 0.0 < period_s <= MAX_SECONDS:
        raise FileFormatError(path, where, "has no period", "period_s above 0")
    return RecordingHeader(arm, joints, units, period_s)


def _parse_sample(path: Path, number: int, line: str, n: int) -> tuple[float, list[float]]:
    row = _parse_object(path, number, line)
    if row.keys() != {"t_s", "q"}:
        raise _recording_error(
            path, number, "is not a sample", '{"t_s": seconds, "q": [positions]}'
        )
    time_s, q = _finite_number(row["t_s"]), row["q"]
    if time_s is None or not 0.0 <= time_s <= MAX_SECONDS:
        raise _recording_error(path, number, f"has t_s = {row['t_s']!r}",
                     f"seconds since the first sample, at most {MAX_SECONDS:.0f}")  # fmt: skip
    values = [_finite_number(x) for x in cast("list[object]", q)] if isinstance(q, list) else []
    if len(values) != n:
        raise _recording_error(path, number, f"has {len(values)} positions", f"{n}, one per joint")
    if None in values:
        raise _recording_error(
            path, number, "has a position that is not a number", "finite numbers"
        )
    return time_s, cast("list[float]", values)


def _parse_object(path: Path, number: int, line: str) -> dict[str, Any]:
    try:
        row = parse_json(line)
    except (ValueError, RecursionError):
        raise _recording_error(path, number, "is not JSON", "one object per line") from None
    if not isinstance(row, dict):
        raise _recording_error(path, number, "is not an object", "one object per line")
    return cast("dict[str, Any]", row)


def _text_tuple(value: object) -> tuple[str, ...]:
    if not isinstance(value, list):
        return ()
    items = cast("Sequence[object]", value)
    texts = tuple(item for item in items if isinstance(item, str))
    return texts if len(texts) == len(items) else ()


def _finite_number(value: object) -> float | None:
    """Return a value as a float if it is a finite number, otherwise None."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def _recording_error(path: Path, number: int, found: str, expected: str) -> FileFormatError:
    return FileFormatError(path, f"line {number}", found, expected)
