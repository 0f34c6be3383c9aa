"""A TOML file becomes plain tables, or one error with line and column."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from ikservo.errors import FileFormatError
from ikservo.files.reading import read_text

__all__ = ["parse_toml", "read_toml"]

LARGEST_BYTES = 256 * 1024
MOST_DOTS = 64

_PLACE = re.compile(r"(.*) \(at (line \d+, column \d+|end of document)\)", re.DOTALL)


def read_toml(path: Path) -> dict[str, Any]:
    """Return the tables of a TOML file.

    Raises:
        FileFormatError: The file cannot be read or is not TOML.
    """
    return parse_toml(path, read_text(path, LARGEST_BYTES))


def parse_toml(path: Path, text: str) -> dict[str, Any]:
    """Return the tables of a TOML text; ``path`` is where it came from, for messages.

    Raises:
        FileFormatError: The text is not TOML, or built to cost more than it is worth.
    """
    _refuse_dotted_bombs(path, text)
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise _located(path, str(error)) from error
    except RecursionError as error:
        raise FileFormatError(path, "", "tables are nested too deeply") from error
    except ValueError as error:  # a whole number of thousands of digits
        raise FileFormatError(path, "", "holds a number that is too long") from error


def _refuse_dotted_bombs(path: Path, text: str) -> None:
    # tomllib needs time and memory in the square of the dots in a key: 128 KiB take gigabytes.
    for number, line in enumerate(text.split("\n"), start=1):
        if line.count(".") > MOST_DOTS and not line.lstrip().startswith("#"):
            found = f"holds {line.count('.')} dots"
            raise FileFormatError(path, f"line {number}", found, f"at most {MOST_DOTS} in a line")


def _located(path: Path, message: str) -> FileFormatError:
    match = _PLACE.fullmatch(message)
    reason, where = match.groups() if match else (message, "")
    return FileFormatError(path, where, f"is not TOML: {reason.rstrip('.')}", "TOML 1.0")
