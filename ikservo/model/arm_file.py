"""An ``arm.toml`` becomes an `ArmFile`, or one error that names the line or the key."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from pydantic import ValidationError

from ikservo.files.complaints import Complaint, complaints_of, first_of
from ikservo.files.quoting import quoted
from ikservo.files.reading import path_inside
from ikservo.files.toml import read_toml
from ikservo.model.arm_checks import contradictions
from ikservo.model.arm_tables import (
    ArmBus,
    ArmFile,
    ArmGripper,
    ArmHealth,
    ArmJoint,
    ArmPose,
    ArmServo,
    ArmShadow,
    ArmSpeed,
    ArmSpeeds,
)
from ikservo.model.catalogue import catalogue_name

__all__ = [
    "ArmBus",
    "ArmFile",
    "ArmGripper",
    "ArmHealth",
    "ArmJoint",
    "ArmPose",
    "ArmServo",
    "ArmShadow",
    "ArmSpeed",
    "ArmSpeeds",
    "read_arm_file",
]


def read_arm_file(path: Path | str) -> ArmFile:
    """Read and check an ``arm.toml``; the URDF it names is not opened.

    Raises:
        FileFormatError: ``where`` is the place in broken TOML, or the path of the key.
    """
    path = Path(path)
    arm = _validated(path, read_toml(path))
    complaints = [*_misplacements(path, arm), *contradictions(arm)]
    if complaints:
        raise first_of(complaints, path)
    return arm


def _validated(path: Path, tables: Mapping[str, object]) -> ArmFile:
    try:
        return ArmFile.model_validate(tables, context={"folder": path.parent})
    except ValidationError as error:
        raise first_of(complaints_of(error, ArmFile), path) from error


def _misplacements(path: Path, arm: ArmFile) -> Iterator[Complaint]:
    folder = catalogue_name(path)
    if folder is not None and folder != arm.name:
        yield Complaint(("name",), f"is {quoted(arm.name)}", f"{quoted(folder)}, like its folder")
    if path_inside(path.parent, arm.urdf) is None:
        yield Complaint(("urdf",), f"is {quoted(arm.urdf)}", "a file in the arm's own folder")
