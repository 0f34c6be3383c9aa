"""A calibration as text: one TOML with a checksum inside, read whole or not at all."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from pydantic import ValidationError

from ikservo.calibration.filing.contradictions import contradictions
from ikservo.calibration.filing.record import Calibration
from ikservo.errors import FileFormatError
from ikservo.files.complaints import complaints_of, first_of
from ikservo.files.guarded import guarded, with_checksum
from ikservo.files.reading import read_text
from ikservo.files.toml import LARGEST_BYTES, parse_toml

__all__ = ["parse_calibration", "read_calibration", "text_of"]

FORMAT = 1
_HEADER = """\
# The calibration of one arm, written by ikservo. It belongs to this arm's own servos, and every
# change must go through `ikservo calibrate`: the checksum above guards each byte below.
"""


def text_of(calibration: Calibration) -> str:
    """Return what stands in the file."""
    import tomli_w  # noqa: PLC0415  # only who writes needs it

    tables = _plain(calibration.model_dump(mode="python", exclude_none=True))
    return with_checksum(_HEADER + tomli_w.dumps(tables))


def read_calibration(path: Path) -> Calibration:
    """Read and check a calibration file.

    Raises:
        FileFormatError: It is spoiled, foreign or of another format; nothing of it was used.
    """
    return parse_calibration(path, read_text(path, LARGEST_BYTES))


def parse_calibration(path: Path, text: str) -> Calibration:
    """Return the calibration that a text is; ``path`` is where it came from, for messages."""
    tables = parse_toml(path, guarded(path, text))
    _refuse_other_formats(path, tables)
    try:
        calibration = Calibration.model_validate(tables)
    except ValidationError as error:
        raise first_of(complaints_of(error, Calibration), path) from error
    complaints = list(contradictions(calibration))
    if complaints:
        raise first_of(complaints, path)
    return calibration


def _plain(value: Any) -> Any:  # noqa: ANN401  # tables of tables
    """Return tables as the writer wants them: lists for tuples, and no empty ones."""
    if isinstance(value, Mapping):
        rows = cast("Mapping[str, Any]", value)
        return {key: _plain(item) for key, item in rows.items() if item != ()}
    if isinstance(value, tuple):
        return [_plain(item) for item in cast("tuple[Any, ...]", value)]
    return value


def _refuse_other_formats(path: Path, tables: Mapping[str, Any]) -> None:
    found = tables.get("format")
    if isinstance(found, int) and not isinstance(found, bool) and found > FORMAT:
        expected = f"format {FORMAT}; a newer ikservo wrote this: pip install --upgrade ikservo"
        raise FileFormatError(path, "format", f"is {found}", expected)
