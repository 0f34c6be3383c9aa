"""What is being written into servos, on disk before the first of them is touched."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from ikservo.errors import FileFormatError
from ikservo.files.complaints import complaints_of, first_of
from ikservo.files.guarded import guarded, with_checksum
from ikservo.files.reading import read_text
from ikservo.files.strict import StrictModel
from ikservo.files.toml import LARGEST_BYTES, parse_toml

__all__ = ["Change", "Journal", "journal_text", "read_journal"]

_HEADER = "# What ikservo is writing into servos. It goes away when that is done.\n"
_Memory = Mapping[Annotated[str, Field(max_length=64)], int]


class Change(StrictModel):
    """One servo: the raw numbers that it held, and those that it shall hold."""

    id: int = Field(ge=0, le=252, description="a whole number from 0 to 252")
    old: _Memory = Field(description="register = raw number")
    new: _Memory = Field(description="register = raw number")


class Journal(StrictModel):
    """A transaction: servos first, then the file.

    Attributes:
        path: The calibration file.
        old_text: What it held; empty where there was none.
        new_text: What it shall hold.
        changes: By servo, in the order in which they are written.
    """

    format: Literal[1] = Field(description="1")
    path: str = Field(description="a file")
    old_text: str = Field(description="the old file")
    new_text: str = Field(description="the new file")
    changes: tuple[Change, ...] = Field(strict=False, description="tables [[changes]]")


def journal_text(journal: Journal) -> str:
    """Return what stands in the file."""
    import tomli_w  # noqa: PLC0415  # only who writes needs it

    tables = journal.model_dump(mode="python")
    return with_checksum(_HEADER + tomli_w.dumps(tables))


def read_journal(path: Path) -> Journal | None:
    """Return what was being written, or None where nothing was.

    Raises:
        FileFormatError: The journal is spoiled.
    """
    if not path.exists():
        return None
    try:
        tables = parse_toml(path, guarded(path, read_text(path, 4 * LARGEST_BYTES)))
        return Journal.model_validate(tables)
    except ValidationError as error:
        raise first_of(complaints_of(error, Journal), path) from error
    except FileFormatError as error:
        expected = "a whole one. Remove it, then compare the servos: ikservo calibration diff"
        raise FileFormatError(path, error.where, error.found, expected) from error
