"""A file of points that somebody has measured: ``NAME X Y Z``, one a line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import typer

from ikservo.cli.quantities import parse_length_m
from ikservo.errors import FileFormatError
from ikservo.files.reading import read_text
from ikservo.model.touch.grid import Place

__all__ = ["read_points"]

_LARGEST_BYTES = 64 * 1024
_EXPECTED = "NAME X Y Z, in metres or like 120mm, the arm's base frame"


def read_points(path: Path) -> list[Place]:
    """Return the points in a file; ``#`` begins a remark.

    Raises:
        FileFormatError: The file cannot be read, or a line is no point; names the line.
    """
    places: list[Place] = []
    for number, line in enumerate(read_text(path, _LARGEST_BYTES).splitlines(), start=1):
        words = line.partition("#")[0].split()
        if words:
            places.append(_place(path, f"line {number}", words))
    return places


def _place(path: Path, where: str, words: list[str]) -> Place:
    if len(words) != 4:
        raise FileFormatError(path, where, "is not a point", _EXPECTED)
    try:
        return Place(words[0], np.array([parse_length_m(word) for word in words[1:]]))
    except typer.BadParameter as error:
        raise FileFormatError(path, where, error.message.rstrip("."), _EXPECTED) from error
