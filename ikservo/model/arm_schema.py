"""The schema of ``arm.toml``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, PrivateAttr

from ikservo.files.validation import FormatOne, Name, Register, RegisterValue, Sign, StrictModel
from ikservo.model.arm_model import HealthLimits

_USUAL = HealthLimits()
# Error messages also use each description as the expected value.
_NAME = "1 to 64 of the characters A-Z a-z 0-9 _ -"
_TEXT = "one line of text"
_EEPROM = "register = raw value, such as { drive_mode = 1 }"

Text = Annotated[str, Field(pattern=r"^[^\p{Cc}]{1,200}$")]
Positive = Annotated[float, Field(gt=0)]
Play = Annotated[float, Field(ge=0, le=10)]
Payload = Annotated[float, Field(ge=0, le=5)]


class ArmBus(StrictModel):
    """``[bus]``: protocol family and baud rate of the servos."""

    family: Literal["feetech_sts", "feetech_scs", "dynamixel_2", "dynamixel_1"] = Field(
        description="feetech_sts, feetech_scs, dynamixel_2 or dynamixel_1"
    )
    baud: int = Field(ge=1_200, le=20_000_000, description="bits per second, such as 1_000_000")
    supply_v: Positive | None = Field(
        default=None, description="voltage, for servos with several versions, such as 7.4"
    )


class ArmSpeed(StrictModel):
    """``[speeds.slow]`` and so on: one value for every revolute joint."""

    deg_s: Positive = Field(description="a speed above 0 deg/s")
    deg_s2: Positive = Field(description="an acceleration above 0 deg/s²")
    deg_s3: Positive = Field(description="a jerk above 0 deg/s³")


class ArmSpeeds(StrictModel):
    """The three selectable speeds."""

    slow: ArmSpeed = Field(description="a table [speeds.slow]")
    normal: ArmSpeed = Field(description="a table [speeds.normal]")
    fast: ArmSpeed = Field(description="a table [speeds.fast]")


class ArmShadow(StrictModel):
    """A servo that drives a joint: ``q = sign * (tick - zero_tick) * 2 pi / 4096`` in radians."""

    id: int = Field(ge=0, le=252, description="a whole number from 0 to 252")
    model: Name = Field(description='a servo model, such as "XM430-W350"')
    sign: Sign = Field(description="1 or -1")
    zero_tick: float = Field(description="a finite number, such as 2048")
    eeprom: Mapping[Register, RegisterValue] = Field(default={}, description=_EEPROM)


class ArmCrank(StrictModel):
    """A crank and a rod between the horn and a prismatic joint; see ``calibration.Crank``."""

    radius_m: Positive = Field(description="metres from the horn's axis to the pin")
    rod_m: Positive = Field(description="metres from the pin to the slide")
    zero_deg: float = Field(gt=0, lt=180, description="the crank's angle at position 0, degrees")


class ArmServo(ArmShadow):
    """The first servo of a joint; with ``m_per_turn`` or ``crank`` the joint is prismatic."""

    m_per_turn: Positive | None = Field(default=None, description="metres per turn, above 0")
    crank: ArmCrank | None = Field(default=None, description="a table { radius_m = …, … }")
    gear: Positive = Field(default=1.0, description="turns of the horn per turn of the joint")


class ArmJoint(StrictModel):
    """``[[joints]]``: a moving joint of the URDF, and its servos."""

    name: Name = Field(description=_NAME)
    role: Literal["arm", "gripper"] = Field(description="arm or gripper")
    zero_from: Literal["vendor", "nominal"] = Field(description="vendor or nominal")
    servo: ArmServo = Field(description="a table { id = …, model = …, sign = …, zero_tick = … }")
    backlash_deg: Play = Field(default=0.0, description="degrees of free horn travel, 0 to 10")
    limits_deg: tuple[float, float] | None = Field(
        default=None, strict=False, description="[lower, upper] instead of the URDF's, degrees"
    )
    limits_m: tuple[float, float] | None = Field(
        default=None, strict=False, description="[lower, upper] of a sliding joint, metres"
    )
    shadows: tuple[ArmShadow, ...] = Field(
        default=(), strict=False, description="a list of tables like servo"
    )

    @property
    def is_prismatic(self) -> bool:
        """Whether the joint is prismatic, so that poses give it in metres."""
        return self.servo.m_per_turn is not None or self.servo.crank is not None


class ArmPose(StrictModel):
    """``[poses.NAME]``: every joint once, revolute joints in degrees, prismatic in metres."""

    deg: Mapping[Name, float] = Field(default={}, description="joint = degrees")
    m: Mapping[Name, float] = Field(default={}, description="joint = metres")


class ArmBox(StrictModel):
    """``[[surroundings.keep_out]]``: an upright box that the arm must not enter."""

    name: Text = Field(description=_TEXT)
    low_m: tuple[float, float, float] = Field(strict=False, description="[x, y, z] in metres")
    high_m: tuple[float, float, float] = Field(strict=False, description="[x, y, z] in metres")


class ArmEnvironment(StrictModel):
    """``[surroundings]``: obstacles around the arm, in its base frame."""

    floor_m: float = Field(default=0.0, description="the height of the table in metres")
    keep_out: tuple[ArmBox, ...] = Field(
        default=(), strict=False, description="tables [[surroundings.keep_out]]"
    )


class ArmHealth(StrictModel):
    """``[health]``: limits of the servos that differ from the defaults."""

    warn_c: Positive = Field(default=_USUAL.warn_c, description="degrees Celsius, such as 60.0")
    hold_c: Positive = Field(default=_USUAL.hold_c, description="degrees Celsius, such as 65.0")
    release_c: Positive = Field(
        default=_USUAL.release_c, description="degrees Celsius, such as 70.0"
    )
    load_percent: Positive = Field(
        default=_USUAL.load_percent, description="percent of the maximum"
    )
    load_s: Positive = Field(default=_USUAL.load_s, description="seconds above 0")
    low_v: Positive | None = Field(default=None, description="volts, such as 6.5")
    high_v: Positive | None = Field(default=None, description="volts, such as 8.4")


Width = Annotated[tuple[float, Annotated[float, Field(ge=0)]], Field(strict=False)]


class ArmGripper(StrictModel):
    """``[gripper]``: properties of the gripper that its joint does not determine."""

    closes_to: Literal["lower", "upper"] | None = Field(
        default=None, description="lower or upper, the limit at which the jaws meet"
    )
    width_m_by_deg: tuple[Width, ...] = Field(
        default=(), strict=False, description="pairs [degrees, metres between the jaws]"
    )
    width_m_by_m: tuple[Width, ...] = Field(
        default=(), strict=False, description="pairs [metres, metres between the jaws]"
    )


class ArmCalibration(StrictModel):
    """``[calibration]``: whether the arm may search for its end stops."""

    auto: bool = Field(default=True, description="true or false")
    reason: Text | None = Field(default=None, description=_TEXT)


class ArmFile(StrictModel):
    """The contents of an ``arm.toml``; ``arm_file_issues`` compares its values."""

    format: FormatOne = Field(description="1")
    name: Name = Field(description=_NAME)
    title: Text = Field(description=_TEXT)
    urdf: Text = Field(description="a file in the arm's own folder")
    tip: Text = Field(description="the URDF link whose frame is the tool")
    source: Text = Field(description=_TEXT)
    base_frame: Text | None = Field(default=None, description=_TEXT)
    base: Text | None = Field(
        default=None,
        description='how the base of the URDF stands on the table: "rotate 90, raise 0.05", '
        "forward, left [m], rotate [deg], or upside down",
    )
    payload_kg: Payload = Field(
        default=0.0, description="the heaviest payload that the servos are to lift, 0 to 5 kg"
    )
    bus: ArmBus = Field(description="a table [bus]")
    speeds: ArmSpeeds = Field(description="tables [speeds.slow], [speeds.normal], [speeds.fast]")
    joints: tuple[ArmJoint, ...] = Field(strict=False, description="tables [[joints]]")
    poses: Mapping[Name, ArmPose] = Field(description="tables [poses.NAME]")
    surroundings: ArmEnvironment = Field(
        default=ArmEnvironment(), description="a table [surroundings]"
    )
    health: ArmHealth = Field(default=ArmHealth(), description="a table [health]")
    calibration: ArmCalibration = Field(
        default=ArmCalibration(), description="a table [calibration]"
    )
    gripper: ArmGripper = Field(default=ArmGripper(), description="a table [gripper]")

    _folder: Path = PrivateAttr(default=Path())

    def model_post_init(self, context: Mapping[str, Path] | None, /) -> None:
        """Store the folder of the file; relative names are resolved against it."""
        self._folder = context["folder"] if context else Path()

    @property
    def urdf_path(self) -> Path:
        """The URDF file; it is in the arm's folder, but need not exist."""
        return self._folder / self.urdf
