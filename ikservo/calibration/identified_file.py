"""The identification file of one arm: its masses and motors."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from ikservo.calibration.paths import identified_path
from ikservo.calibration.records import Name, Text
from ikservo.errors import FileFormatError
from ikservo.files.reading import MAX_BYTES, parse_toml, quote, read_text
from ikservo.files.validation import StrictModel
from ikservo.files.writing import checked_toml, strip_checksum, write_atomic

_HEADER = """\
# Masses and motors of one arm, written by `ikservo identify`. `ikservo sim --as-identified`
# simulates this arm; the values of a joint are for each of its servos, at the horn.
"""

Torque = Annotated[float, Field(gt=0, le=1000)]
Friction = Annotated[float, Field(ge=0, le=1000)]
Share = Annotated[float, Field(ge=0, lt=0.5)]
_FRICTION, _SHARE = "N m, zero or more", "a number from 0 to 0.5"


class IdentifiedJoint(StrictModel):
    """``[[joints]]``: the servos of a joint, and the mass between this joint and the next."""

    name: Name = Field(description="1 to 64 of the characters A-Z a-z 0-9 _ -")
    mass_scale: float = Field(gt=0, le=10, description="a factor on the arm file's mass")
    stiffness_nm_rad: Torque = Field(description="N m per rad, above zero")
    p_gain: int | None = Field(
        default=None, ge=0, description="the register's value at identification"
    )
    full_duty_nm: Torque = Field(description="N m at nominal supply, above zero")
    back_emf_nm_s: Torque = Field(description="N m per rad/s, above zero")
    viscous_nm_s: Friction = Field(description="N m per rad/s, zero or more")
    coulomb_nm: Friction = Field(description=_FRICTION)
    load: Share = Field(description=_SHARE)
    slow_nm: Friction = Field(description=_FRICTION)
    slow_load: Share = Field(description=_SHARE)
    slow_rad_s: Annotated[float, Field(gt=0, le=100)] = Field(description="rad/s, above zero")
    backlash_rad: Annotated[float, Field(ge=0, le=0.2)] | None = Field(
        default=None, description="rad, if it was measured"
    )
    errors: Mapping[Name, Friction] = Field(description="standard errors, by key")


class IdentifiedArm(StrictModel):
    """The content of an identification file."""

    format: Literal[1] = Field(description="1")
    arm: Name = Field(description="an arm's name")
    written: datetime = Field(description="a date and time with UTC offset")
    tool_version: Text = Field(description="the version of ikservo")
    usb_serial_number: Text = Field(description="the adapter's serial number, or empty")
    joints: tuple[IdentifiedJoint, ...] = Field(
        strict=False, min_length=1, description="tables [[joints]]"
    )

    def joint(self, name: str) -> IdentifiedJoint | None:
        """Return the joint with a name, or None."""
        return next((joint for joint in self.joints if joint.name == name), None)


def dump_identified(arm: IdentifiedArm) -> str:
    """Format the identification of an arm as the text of its file."""
    return checked_toml(_HEADER, arm.model_dump(mode="python", exclude_none=True))


def read_identified(path: Path) -> IdentifiedArm:
    """Read and check the file of an identified arm.

    Raises:
        FileFormatError: The file is damaged, or is not an identification.
    """
    tables = parse_toml(path, strip_checksum(path, read_text(path, MAX_BYTES)))
    identified = IdentifiedArm.from_tables(tables, path)
    names = [joint.name for joint in identified.joints]
    for i, name in enumerate(names):
        if name in names[:i]:
            where = f"joints[{i}].name"
            raise FileFormatError(path, where, f"repeats {quote(name)}", "a unique name")
    return identified


def load_identified(arm: str, usb_serial_number: str) -> IdentifiedArm | None:
    """Load the identification of an arm on an adapter; None if the arm was not identified.

    Raises:
        FileFormatError: The file is damaged.
    """
    path = identified_path(arm, usb_serial_number)
    return read_identified(path) if path.exists() else None


def save_identified(identified: IdentifiedArm) -> Path:
    """Write the file of an identified arm; the previous file is kept as a backup.

    Raises:
        FileWriteError: The file cannot be written; the previous file is unchanged.
    """
    path = identified_path(identified.arm, identified.usb_serial_number)
    write_atomic(path, dump_identified(identified), keep_old=True)
    return path
