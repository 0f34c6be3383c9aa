"""A complete or partial calibration, as stored in its file; keys contain their units."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from ikservo.calibration.joint_limits import Limit, Limits
from ikservo.calibration.joint_map import JointMap
from ikservo.files.reading import MAX_BYTES, parse_toml, read_text
from ikservo.files.validation import FormatOne, Name, Register, RegisterValue, Sign, StrictModel
from ikservo.files.writing import checked_toml, strip_checksum
from ikservo.kinematics.arrays import Vector

RangeSource = Literal["by hand", "by LeRobot", "by itself", "not swept"]

_HEADER = "# Measurements of `ikservo calibrate --auto`. The next run continues from here.\n"


# Error messages also use each description as the expected value.
Text = Annotated[str, Field(pattern=r"^[^\p{Cc}]{0,200}$")]
Tick = Annotated[int, Field(ge=-(2**20), le=2**20)]
# Larger corrections indicate another arm, because no manufacturing tolerance is so large.
Move = Annotated[float, Field(ge=-50.0, le=50.0)]
Rotation = Annotated[float, Field(ge=-20.0, le=20.0)]
_MOVE, _ROTATION = "[x, y, z] in mm, each at most ±50", "[x, y, z] in degrees, each at most ±20"


class CalibratedServo(StrictModel):
    """A servo, and the raw numbers that its EEPROM held at calibration."""

    id: int = Field(ge=0, le=252, description="a whole number from 0 to 252")
    model: Name = Field(description='a servo model, such as "STS3215"')
    firmware: Text = Field(description="the version that the servo reports, or empty")
    holds: Mapping[Register, RegisterValue] = Field(description="register = raw number")


class CalibratedJoint(StrictModel):
    """A joint of one arm: its zero, its range, and the registers of its servos."""

    name: Name = Field(description="1 to 64 of the characters A-Z a-z 0-9 _ -")
    sign: Sign = Field(description="1 or -1")
    sign_from: Literal["by hand", "arm file"] = Field(description="by hand or arm file")
    zero_tick: float = Field(ge=-(2**20), le=2**20, description="a tick, such as 2047.5")
    gear: float = Field(gt=0, description="turns of the horn per turn of the joint")
    extended: bool = Field(description="true if the servo counts beyond one turn")
    swept: RangeSource = Field(description="by hand, by LeRobot, by itself or not swept")
    travel_ticks: tuple[Tick, Tick] = Field(
        strict=False, description="[lowest, highest] tick, as reported, turns included"
    )
    lower_deg: float | None = Field(default=None, description="degrees, inside the swept range")
    upper_deg: float | None = Field(default=None, description="degrees, inside the swept range")
    lower_m: float | None = Field(default=None, description="metres, inside the swept range")
    upper_m: float | None = Field(default=None, description="metres, inside the swept range")
    user_lower_deg: float | None = Field(default=None, description="degrees")
    user_upper_deg: float | None = Field(default=None, description="degrees")
    user_lower_m: float | None = Field(default=None, description="metres")
    user_upper_m: float | None = Field(default=None, description="metres")
    compliance: float = Field(
        default=0.0, ge=0.0, le=1.0, description="rad per N m behind the encoder, 0 to 1"
    )
    play_deg: float = Field(
        default=0.0, ge=0.0, le=5.0, description="degrees of backlash behind the encoder"
    )
    servo: CalibratedServo = Field(description="a table [joints.servo]")
    shadows: tuple[CalibratedServo, ...] = Field(
        default=(), strict=False, description="tables [[joints.shadows]]"
    )

    @property
    def servos(self) -> tuple[CalibratedServo, ...]:
        """The joint's first servo, then its other servos."""
        return (self.servo, *self.shadows)

    def recorded_range(self) -> tuple[float, float] | None:
        """Return the recorded range [rad or m] minus the margin; None if not recorded."""
        low, high = _to_si(self.lower_deg, self.lower_m), _to_si(self.upper_deg, self.upper_m)
        return None if low is None or high is None else (low, high)

    def user_range(self) -> tuple[float | None, float | None]:
        """Return the limits [rad or m] set by the user; None if not set."""
        lower = _to_si(self.user_lower_deg, self.user_lower_m)
        return lower, _to_si(self.user_upper_deg, self.user_upper_m)

    def joint_map(self, nominal: JointMap) -> JointMap:
        """Return the arm file's map of the joint with this arm's sign and zero."""
        return nominal.with_mounting(self.sign, self.zero_tick)


class CalibratedOrigin(StrictModel):
    """The corrected origin of a joint, for a link whose length differs from the arm file's."""

    joint: Name = Field(description="a joint between base and tip")
    moved_mm: tuple[Move, Move, Move] = Field(strict=False, description=_MOVE)


class CalibratedGeometry(StrictModel):
    """``[geometry]``: corrections of links and base relative to the arm file, by touch-off."""

    touched: datetime = Field(description="a date and time with UTC offset")
    touches: int = Field(ge=1, le=10_000, description="a whole number")
    left_out: int = Field(ge=0, le=10_000, description="a whole number")
    before_mm: float = Field(ge=0, description="millimetres, on touches left out")
    after_mm: float = Field(ge=0, description="millimetres, on touches left out")
    base_moved_mm: tuple[Move, Move, Move] = Field(strict=False, description=_MOVE)
    base_turned_deg: tuple[Rotation, Rotation, Rotation] = Field(
        strict=False, description=_ROTATION
    )
    origins: tuple[CalibratedOrigin, ...] = Field(
        default=(), strict=False, description="tables [[geometry.origins]]"
    )


class SeenBoard(StrictModel):
    """A calibration board, and its pose on the tip or in the base frame."""

    name: Text = Field(description="COLUMNSxROWS-SQUAREmm-FAMILY")
    scale: float = Field(default=1.0, gt=0.5, lt=2.0, description="factor on the size in its name")
    at_mm: tuple[float, float, float] = Field(strict=False, description="[x, y, z] in mm")
    turned_deg: tuple[float, float, float] = Field(
        strict=False, description="a rotation vector in degrees"
    )


class TipClick(StrictModel):
    """The zero of the last joint according to one click on the tip, with its standard errors."""

    off_deg: float = Field(ge=-90.0, le=90.0, description="degrees, true minus measured position")
    click_deg: float = Field(ge=1e-4, description="degrees, standard error of the click")
    camera_deg: float = Field(ge=0.0, description="degrees, standard error of the camera")


_Pixels = Annotated[int, Field(ge=1, le=100_000)]
_FocalLength = Annotated[float, Field(gt=0)]  # a negative value would mirror each click


class CalibratedCamera(StrictModel):
    """``[camera]``: a camera that has seen the arm, and its position."""

    source: Text = Field(description="a number, device or address")
    seen: datetime = Field(description="a date and time with UTC offset")
    pictures: int = Field(ge=1, le=10_000, description="a whole number")
    left_out: int = Field(ge=0, le=10_000, description="a whole number")
    before_mm: float = Field(ge=0, description="millimetres, in pictures left out")
    after_mm: float = Field(ge=0, description="millimetres, in pictures left out")
    size_px: tuple[_Pixels, _Pixels] = Field(strict=False, description="[width, height] in pixels")
    lens_px: tuple[_FocalLength, _FocalLength, float, float] = Field(
        strict=False, description="[fx, fy, cx, cy] in pixels"
    )
    distortion: tuple[float, float, float, float, float] = Field(
        strict=False, description="[k1, k2, p1, p2, k3]"
    )
    at_mm: tuple[float, float, float] = Field(
        strict=False, description="[x, y, z] in mm, the arm's base frame"
    )
    turned_deg: tuple[float, float, float] = Field(
        strict=False, description="a rotation vector in degrees"
    )
    board: SeenBoard | None = Field(default=None, description="a table [camera.board]")
    tip_shows: Name | None = Field(
        default=None, description="a joint whose zero can be seen only at the tip, not on the board"
    )
    tip_clicks: tuple[TipClick, ...] = Field(
        default=(), strict=False, description="tables [[camera.tip_clicks]]"
    )


class Calibration(StrictModel):
    """The content of a calibration file; ``inconsistencies`` compares its values."""

    format: FormatOne = Field(description="1")
    arm: Name = Field(description="an arm's name")
    written: datetime = Field(description="a date and time with UTC offset")
    tool_version: Text = Field(description="the version of ikservo")
    usb_serial_number: Text = Field(description="the adapter's serial number, or empty")
    family: Name = Field(description="feetech_sts, dynamixel_2 …")
    anchor_pose: Name = Field(description="a pose of the arm file")
    margin_deg: float = Field(ge=0, lt=45, description="degrees from each swept end to the limit")
    joints: tuple[CalibratedJoint, ...] = Field(
        strict=False, min_length=1, description="tables [[joints]]"
    )
    geometry: CalibratedGeometry | None = Field(default=None, description="a table [geometry]")
    camera: CalibratedCamera | None = Field(default=None, description="a table [camera]")
    cameras: dict[Name, CalibratedCamera] = Field(
        default_factory=dict[str, CalibratedCamera], description="tables [cameras.NAME]"
    )

    @property
    def cameras_by_name(self) -> dict[str, CalibratedCamera]:
        """All cameras by name; the camera of ``[camera]`` has an empty name."""
        return ({"": self.camera} if self.camera else {}) | self.cameras

    def with_cameras(self, cameras: Mapping[str, CalibratedCamera]) -> Calibration:
        """Return a calibration with different cameras, in the form of ``cameras_by_name``."""
        named = {name: camera for name, camera in cameras.items() if name}
        return self.model_copy(update={"camera": cameras.get(""), "cameras": named})

    def joint(self, name: str) -> CalibratedJoint | None:
        """Return the joint with a name, or None."""
        return next((joint for joint in self.joints if joint.name == name), None)

    def narrow_limits(self, joint: CalibratedJoint, limits: Limits) -> Limits:
        """Return limits restricted to the recorded range and the user's limits of a joint.

        Raises:
            CalibrationError: The intersection is empty; both limits are named.
        """
        swept = joint.recorded_range()
        if swept:
            limits = limits.intersect(
                Limits.of(joint.name, *swept, self.source(joint), limits.unit)
            )
        lower, upper = joint.user_range()
        low = limits.lower if lower is None else Limit(lower, "user")
        high = limits.upper if upper is None else Limit(upper, "user")
        return limits.intersect(Limits(joint.name, low, high, limits.unit))

    def source(self, joint: CalibratedJoint) -> str:
        """Return the source of a joint's range, such as ``hand sweep of 2026-11-02``."""
        sweeps = {"by LeRobot": "LeRobot's sweep", "by itself": "the arm's own sweep"}
        sweep = sweeps.get(joint.swept, "hand sweep")
        return f"{sweep} of {self.written:%Y-%m-%d}"


def _to_si(degrees: float | None, metres: float | None) -> float | None:
    return math.radians(degrees) if degrees is not None else metres


class StoredJointMeasurement(StrictModel):
    """Travel of one joint between its end stops, in raw encoder ticks."""

    name: str = Field(max_length=64, description="a joint")
    servo_id: int = Field(ge=0, le=252, description="a whole number from 0 to 252")
    servo_model: str = Field(max_length=64, description="a model")
    low_tick: int = Field(description="a whole number")
    high_tick: int = Field(description="a whole number")


class PartialCalibration(StrictModel):
    """Joints that an interrupted self-calibration has measured, of one arm on one adapter."""

    format: Literal[1] = Field(description="1")
    arm: str = Field(max_length=64, description="an arm")
    written: str = Field(max_length=64, description="a time")
    joints: tuple[StoredJointMeasurement, ...] = Field(
        strict=False, description="tables [[joints]]"
    )


def dump_partial(partial: PartialCalibration) -> str:
    """Format an incomplete calibration as the text of its file."""
    return checked_toml(_HEADER, partial.model_dump(mode="python"))


def read_partial(path: Path) -> PartialCalibration | None:
    """Read the stored measurements; None if there is no file.

    Raises:
        FileFormatError: The file is damaged.
    """
    if not path.exists():
        return None
    table = parse_toml(path, strip_checksum(path, read_text(path, MAX_BYTES)))
    return PartialCalibration.from_tables(table, path)


def shift_zeros(
    joints: Sequence[CalibratedJoint], maps: Sequence[JointMap], zeros: Vector
) -> tuple[CalibratedJoint, ...]:
    """Return joints with positions increased by ``zeros`` (dof,), except joints without a map.

    The ticks of end stops do not change. The user's limits are positions and do not change, either.
    """
    shifts = {m.joint: (m, float(zero)) for m, zero in zip(maps, zeros, strict=True)}
    shifted = list(joints)
    for i, joint in enumerate(joints):
        if joint.name not in shifts:
            continue
        joint_map, shift = shifts[joint.name]
        ends = {"lower_deg": math.degrees(shift), "upper_deg": math.degrees(shift)}
        ends |= {"lower_m": shift, "upper_m": shift}
        known = {key: getattr(joint, key) for key in ends if getattr(joint, key) is not None}
        moved = {key: end + ends[key] for key, end in known.items()}
        ticks = joint_map.sign * shift / joint_map.unit_per_tick
        moved["zero_tick"] = joint.zero_tick - ticks
        shifted[i] = joint.model_copy(update=moved)
    return tuple(shifted)
