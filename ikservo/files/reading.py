"""Read text, TOML and strict JSON files; errors name the path and the line."""

from __future__ import annotations

import json
import os
import os.path
import re
import stat
import tomllib
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import Any, NoReturn, cast

from ikservo.errors import BadValueError, FileFormatError, shown

_OUTWARD = ("\\", ":", "\0")  # other separators, drives and schemes such as package:// or http://
_MAX_NAME_CHARS = 1024


def parse_path(value: object) -> Path:
    """Parse the path to a file.

    Raises:
        BadValueError: The value is neither text nor a path.
    """
    if not isinstance(value, str | os.PathLike):
        raise BadValueError("The file", shown(value), "a path")
    return Path(cast("str", value))


def read_text(path: Path, limit_bytes: int) -> str:
    """Read the text of a regular file in UTF-8, with or without a byte order mark.

    Raises:
        FileFormatError: The file is missing, not a file, unreadable, too large, empty or not UTF-8.
    """
    require_file(path)
    try:
        with path.open("rb") as file:
            data = file.read(limit_bytes + 1)
    except OSError as error:
        raise FileFormatError(path, "", f"cannot be read ({error.strerror})") from error
    if len(data) > limit_bytes:
        raise FileFormatError(path, "", "is too large", f"at most {limit_bytes // 1024} KiB")
    if not data.strip():
        raise FileFormatError(path, "", "is empty")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        found = f"holds the byte 0x{error.object[error.start]:02X}, which is not UTF-8"
        raise FileFormatError(path, f"line {line}", found, "text in UTF-8") from error


def require_file(path: Path) -> None:
    """Refuse anything but a regular file, because reading a pipe or a terminal may never end.

    Raises:
        FileFormatError: The file does not exist, is not a regular file, or cannot be accessed.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError as error:
        raise FileFormatError(path, "", "does not exist") from error
    except OSError as error:
        raise FileFormatError(path, "", f"cannot be read ({error.strerror})") from error
    except ValueError as error:  # a null byte in the path
        raise FileFormatError(path, "", "is not a valid path") from error
    if stat.S_ISDIR(mode):
        raise FileFormatError(path, "", "is a folder", "a file")
    if not stat.S_ISREG(mode):
        raise FileFormatError(path, "", "is not a regular file", "a file")


def parse_json(text: str | bytes, parse_int: Callable[[str], int] | None = None) -> Any:  # noqa: ANN401
    """Parse the value of a JSON text; refuse a key that appears twice, NaN and Infinity.

    Raises:
        ValueError: The text is not valid JSON, or not UTF-8.
        RecursionError: The text is nested too deeply.
    """
    return json.loads(
        text, object_pairs_hook=_unique, parse_constant=_no_number, parse_int=parse_int
    )


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) != len(pairs):
        raise ValueError("a key appears twice")
    return table


def _no_number(name: str) -> NoReturn:
    raise ValueError(f"it contains {name}")


def path_inside(folder: Path, name: str) -> Path | None:
    """Resolve a relative name to a path inside ``folder``; return None if it leads outside.

    The name is checked first, so that no file outside is accessed. Then symbolic links are
    resolved, so that none leads outside. The file is not opened and may be missing.
    """
    if not name or len(name) > _MAX_NAME_CHARS or any(sign in name for sign in _OUTWARD):
        return None
    relative = PurePosixPath(name)
    if relative.is_absolute() or ".." in relative.parts:
        return None
    home = Path(os.path.realpath(folder))
    path = Path(os.path.realpath(home / relative))
    return path if path != home and path.is_relative_to(home) else None


MAX_BYTES = 256 * 1024
MAX_DOTS = 64

_PLACE = re.compile(r"(.*) \(at (line \d+, column \d+|end of document)\)", re.DOTALL)


def read_toml(path: Path) -> dict[str, Any]:
    """Read the tables of a TOML file.

    Raises:
        FileFormatError: The file cannot be read or is not TOML.
    """
    return parse_toml(path, read_text(path, MAX_BYTES))


def parse_toml(path: Path, text: str) -> dict[str, Any]:
    """Parse the tables of a TOML text; ``path`` is its origin, for messages.

    Raises:
        FileFormatError: The text is not TOML, or would be too expensive to parse.
    """
    # tomllib's time and memory grow with the square of the dots in a key: 128 KiB take gigabytes.
    for number, line in enumerate(text.split("\n"), start=1):
        if line.count(".") > MAX_DOTS and not line.lstrip().startswith("#"):
            what = (
                "values, such as joint angles"
                if "{" in line
                else "decimal fractions or dots in names"
            )
            found = f"has {line.count('.')} {what}"
            expected = (
                f"at most {MAX_DOTS} in a line; write each joint of a pose in its own line: "
                "deg.NAME = 1.5"
            )
            raise FileFormatError(path, f"line {number}", found, expected)
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        match = _PLACE.fullmatch(str(error))
        reason, where = match.groups() if match else (str(error), "")
        found = f"is not TOML: {reason.rstrip('.')}"
        raise FileFormatError(path, where, found, "TOML 1.0") from error
    except RecursionError as error:
        raise FileFormatError(path, "", "tables are nested too deeply") from error
    except ValueError as error:  # an integer of thousands of digits
        raise FileFormatError(path, "", "holds a number that is too long") from error


_MAX_QUOTED_CHARS = 60


def quote(text: str) -> str:
    """Return the text in quotes, shortened, with control characters escaped."""
    short = text if len(text) <= _MAX_QUOTED_CHARS else f"{text[: _MAX_QUOTED_CHARS - 1]}…"
    return f'"{short}"' if short.isprintable() else ascii(short)


def config_dir() -> Path:
    """Return the folder of the user's own files: ``IKSERVO_HOME``, or the system's default."""
    own = os.environ.get("IKSERVO_HOME")
    if own:
        return Path(own)
    from platformdirs import user_config_path  # noqa: PLC0415  # only where it is needed

    return user_config_path("ikservo", appauthor=False)
