"""Joints measured by a calibration that was interrupted, stored for the next run."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field, ValidationError

from ikservo.files.reading import MAX_BYTES, parse_toml, read_text
from ikservo.files.validation import StrictModel, first_issue, validation_issues
from ikservo.files.writing import strip_checksum, with_checksum

__all__ = ["PartialCalibration", "StoredJointMeasurement", "dump_partial", "read_partial"]

_HEADER = "# What `ikservo calibrate --auto` has measured so far. The next run goes on from here.\n"


class StoredJointMeasurement(StrictModel):
    """The travel of one joint between its stops, in ticks of the bare encoder."""

    name: str = Field(max_length=64, description="a joint")
    servo_id: int = Field(ge=0, le=252, description="a whole number from 0 to 252")
    servo_model: str = Field(max_length=64, description="a model")
    low_tick: int = Field(description="a whole number")
    high_tick: int = Field(description="a whole number")


class PartialCalibration(StrictModel):
    """The measured joints of one arm on one adapter."""

    format: Literal[1] = Field(description="1")
    arm: str = Field(max_length=64, description="an arm")
    written: str = Field(max_length=64, description="a time")
    joints: tuple[StoredJointMeasurement, ...] = Field(
        strict=False, description="tables [[joints]]"
    )


def dump_partial(partial: PartialCalibration) -> str:
    """Return what stands in the file."""
    import tomli_w  # noqa: PLC0415  # only who writes needs it

    return with_checksum(_HEADER + tomli_w.dumps(partial.model_dump(mode="python")))


def read_partial(path: Path) -> PartialCalibration | None:
    """Return what was measured; None where there is no file.

    Raises:
        FileFormatError: The file is spoiled.
    """
    if not path.exists():
        return None
    table = parse_toml(path, strip_checksum(path, read_text(path, MAX_BYTES)))
    try:
        return PartialCalibration.model_validate(table)
    except ValidationError as error:
        raise first_issue(validation_issues(error, PartialCalibration), path) from error
