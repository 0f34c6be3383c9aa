"""Reading a recording: every line is what it should be, or the first that is not is named."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np

from ikservo.arm.given import file_path
from ikservo.arm.tapes.tape import SCHEMA, Heading, Recording
from ikservo.errors import FileFormatError
from ikservo.files.reading import parse_json

__all__ = ["read_recording"]

_LONGEST_LINE = 16_384
_MOST_SECONDS = 20_000.0
_MOST_SAMPLES = 2_000_000  # at 100 Hz
_KEYS = {"schema", "arm", "joints", "units", "period_s"}


def read_recording(path: Path | str) -> Recording:
    """Read a recording.

    Raises:
        FileFormatError: It cannot be read, or a line is not what it should be; says which.
    """
    path = file_path(path)
    lines = _lines(path)
    heading = _heading(path, next(lines, ""))
    times_s: list[float] = []
    joints: list[list[float]] = []
    for number, line in enumerate(lines, start=2):
        time_s, q = _sample(path, number, line, len(heading.joints))
        if times_s and time_s <= times_s[-1]:
            raise _wrong(path, number, f"has t_s = {time_s:g}", "a later time than the line before")
        if len(times_s) >= _MOST_SAMPLES:
            raise _wrong(path, number, "is one sample too many", f"at most {_MOST_SAMPLES} samples")
        times_s.append(time_s)
        joints.append(q)
    if not times_s:
        raise FileFormatError(path, "", "has no sample", "at least one line behind the header")
    return Recording(heading, np.array(times_s), np.array(joints))


def _lines(path: Path) -> Iterator[str]:
    try:
        with path.open("rb") as file:
            number = 0
            while line := file.readline(_LONGEST_LINE + 1):
                number += 1
                yield _whole(path, number, line)
    except OSError as error:
        raise FileFormatError(path, "", f"cannot be read ({error.strerror})") from error
    except ValueError as error:
        if isinstance(error, FileFormatError):
            raise
        raise FileFormatError(path, "", "cannot be a path") from error


def _whole(path: Path, number: int, line: bytes) -> str:
    if len(line) > _LONGEST_LINE:
        raise _wrong(path, number, "is too long", f"at most {_LONGEST_LINE} bytes")
    if not line.endswith(b"\n"):
        raise _wrong(path, number, "is incomplete", "a whole line; delete it to use the others")
    try:
        return line.decode()
    except UnicodeDecodeError:
        raise _wrong(path, number, "is not text in UTF-8", "JSON") from None


def _heading(path: Path, line: str) -> Heading:
    row = _object(path, 1, line or "\n")
    if row.get("schema") != SCHEMA:
        raise _wrong(path, 1, "is not the header of a recording", f'"schema": "{SCHEMA}"')
    if row.keys() != _KEYS:
        odd = ", ".join(sorted(row.keys() ^ _KEYS))
        raise _wrong(path, 1, f"differs in: {odd}", f"the keys {', '.join(sorted(_KEYS))}")
    joints, units = _words(row["joints"]), _words(row["units"])
    if not (isinstance(row["arm"], str) and joints and len(set(joints)) == len(joints)):
        raise _wrong(path, 1, "has no arm or joints", "the arm's name and each joint once")
    if len(units) != len(joints) or not set(units) <= {"rad", "m"}:
        raise _wrong(path, 1, "has other units", '"rad" or "m" for each joint')
    period_s = _number(row["period_s"])
    if period_s is None or not 0.0 < period_s <= _MOST_SECONDS:
        raise _wrong(path, 1, "has no period", "period_s above 0")
    return Heading(row["arm"], joints, units, period_s)


def _sample(path: Path, number: int, line: str, n: int) -> tuple[float, list[float]]:
    row = _object(path, number, line)
    if row.keys() != {"t_s", "q"}:
        raise _wrong(path, number, "is not a sample", '{"t_s": seconds, "q": [positions]}')
    time_s, q = _number(row["t_s"]), row["q"]
    if time_s is None or not 0.0 <= time_s <= _MOST_SECONDS:
        raise _wrong(path, number, f"has t_s = {row['t_s']!r}",
                     f"seconds since the first sample, {_MOST_SECONDS:.0f} at most")  # fmt: skip
    values = [_number(x) for x in cast("list[object]", q)] if isinstance(q, list) else []
    if len(values) != n:
        raise _wrong(path, number, f"has {len(values)} positions", f"{n}, one a joint")
    if None in values:
        raise _wrong(path, number, "has a position that is not a number", "finite numbers")
    return time_s, cast("list[float]", values)


def _object(path: Path, number: int, line: str) -> dict[str, Any]:
    try:
        row = parse_json(line)
    except (ValueError, RecursionError):
        raise _wrong(path, number, "is not JSON", "one object a line") from None
    if not isinstance(row, dict):
        raise _wrong(path, number, "is not an object", "one object a line")
    return cast("dict[str, Any]", row)


def _words(value: object) -> tuple[str, ...]:
    if not isinstance(value, list):
        return ()
    items = cast("Sequence[object]", value)
    return tuple(item for item in items if isinstance(item, str)) if _all_text(items) else ()


def _all_text(items: Sequence[object]) -> bool:
    return all(isinstance(item, str) for item in items)


def _number(value: object) -> float | None:
    """Return a finite number, or None for anything else."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def _wrong(path: Path, number: int, found: str, expected: str) -> FileFormatError:
    return FileFormatError(path, f"line {number}", found, expected)
