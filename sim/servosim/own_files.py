"""Read the simulator's own files; their size is checked before they are parsed."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

MAX_BYTES = 256 * 1024
MAX_DOTS = 64
"""Largest number of dots per line of TOML: tomllib's time and memory grow with its square."""


def read_text(path: Path) -> str:
    """Read the text of a file.

    Raises:
        OSError: The file cannot be read.
        ValueError: The file is not UTF-8, not a regular file, or too large.
    """
    if not path.is_file() and path.exists():  # reading a pipe would wait forever
        raise ValueError("it is not a regular file")
    with path.open("rb") as file:
        data = file.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise ValueError(f"it is larger than {MAX_BYTES // 1024} KiB")
    return data.decode()


def read_toml(path: Path) -> dict[str, Any]:
    """Read the tables of a TOML file.

    Raises:
        OSError: The file cannot be read.
        ValueError: The text is not TOML, or would be too expensive to parse.
    """
    text = read_text(path)
    if any(line.count(".") > MAX_DOTS for line in text.split("\n")):
        raise ValueError(f"a line has more than {MAX_DOTS} dots")
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise ValueError("tables are nested too deeply") from error


def parse_json(text: str | bytes) -> Any:  # noqa: ANN401
    """Parse the value of a JSON text.

    Raises:
        ValueError: The text is not JSON, or nested too deeply.
    """
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
