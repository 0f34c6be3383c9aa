"""Arm files: the servos of each joint, their mounting and delivery settings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from servosim.errors import ArmFileError
from servosim.joint import DIRECT, CrankAndRod, Ratio, Transmission
from servosim.own_files import read_toml


@dataclass(frozen=True, slots=True)
class ServoEntry:
    """A servo as described in the arm file.

    Attributes:
        id: The id on the bus.
        model: The model in the datasheet.
        sign: +1 if ticks increase with the joint coordinate, -1 if they decrease.
        zero_tick: Reported tick at joint zero.
        transmission: Transmission between its horn and the joint.
        eeprom: Register values that differ from the factory settings.
    """

    id: int
    model: str
    sign: int
    zero_tick: float
    transmission: Transmission = DIRECT
    eeprom: Mapping[str, int] = field(default_factory=dict[str, int])


@dataclass(frozen=True, slots=True)
class JointEntry:
    """A joint and its servos, the leading servo first; limits of None are those of the URDF."""

    name: str
    servos: tuple[ServoEntry, ...]
    limits: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class SimulatedArmFile:
    """The parts of an arm file that the simulator needs.

    Attributes:
        path: The file.
        name: The arm.
        urdf: The geometry and masses.
        family: Servo family of the bus.
        baud: Rate of the bus.
        supply_v: Supply voltage, which selects the variant of a servo model; None uses the variant
            that the model's name gives.
        joints: Joints from base to tip.
        poses: Joint coordinates [rad or m] by pose and joint.
        floor_m: Height of the table in the base frame.
        tip: The link whose origin is the arm's tip; empty if the file names none.
        base: The pose of the URDF's base, see `base_pose`; empty uses the one in the file.
    """

    path: Path
    name: str
    urdf: Path
    family: str
    baud: int
    joints: tuple[JointEntry, ...]
    poses: Mapping[str, Mapping[str, float]]
    floor_m: float = 0.0
    tip: str = ""
    base: str = ""
    supply_v: float | None = None


def read_arm_file(path: Path, urdf: Path | str = "") -> SimulatedArmFile:
    """Read the contents of an ``arm.toml``.

    Args:
        path: The file.
        urdf: A URDF that replaces the one in the file; empty uses the one in the file.

    Raises:
        ArmFileError: The file is missing, not TOML, or lacks a key.
    """
    try:
        document = read_toml(path)
    except (OSError, ValueError) as error:
        raise ArmFileError(path, "", str(error)) from error
    try:
        arm = _parse_arm(path, document)
    except KeyError as error:
        raise ArmFileError(path, "", f"key {error} is missing") from error
    except (TypeError, ValueError, AttributeError) as error:
        raise ArmFileError(path, "", f"a value has the wrong kind: {error}") from error
    return replace(arm, urdf=Path(urdf)) if urdf else arm


def _parse_arm(path: Path, document: dict[str, Any]) -> SimulatedArmFile:
    return SimulatedArmFile(
        path=path,
        name=str(document["name"]),
        urdf=path.parent / str(document["urdf"]),
        family=str(document["bus"]["family"]),
        baud=int(document["bus"]["baud"]),
        joints=tuple(_parse_joint(entry) for entry in document["joints"]),
        poses={name: _parse_pose(table) for name, table in document["poses"].items()},
        floor_m=float(document.get("surroundings", {}).get("floor_m", 0.0)),
        tip=str(document.get("tip", "")),
        base=str(document.get("base", "")),
        supply_v=float(document["bus"]["supply_v"]) if "supply_v" in document["bus"] else None,
    )


def _parse_joint(entry: dict[str, Any]) -> JointEntry:
    servos = [entry["servo"], *entry.get("shadows", []), *entry["servo"].get("shadows", [])]
    return JointEntry(
        str(entry["name"]), tuple(_parse_servo(servo) for servo in servos), _parse_limits(entry)
    )


def _parse_limits(entry: dict[str, Any]) -> tuple[float, float] | None:
    for key, unit in (("limits_deg", math.radians(1.0)), ("limits_m", 1.0)):
        if key in entry:
            lower, upper = (unit * float(each) for each in entry[key])
            return lower, upper
    return None


def _parse_servo(entry: dict[str, Any]) -> ServoEntry:
    return ServoEntry(
        id=int(entry["id"]),
        model=str(entry["model"]),
        sign=int(entry["sign"]),
        zero_tick=float(entry["zero_tick"]),
        transmission=_parse_transmission(entry),
        eeprom={str(name): int(value) for name, value in entry.get("eeprom", {}).items()},
    )


def _parse_transmission(entry: dict[str, Any]) -> Transmission:
    """Parse a rack (`m_per_turn`), a `crank`, a `gear`, or the horn itself."""
    if "crank" in entry:
        crank = entry["crank"]
        zero_rad = math.radians(float(crank["zero_deg"]))
        return CrankAndRod(float(crank["radius_m"]), float(crank["rod_m"]), zero_rad)
    if "m_per_turn" in entry:
        return Ratio(float(entry["m_per_turn"]) / (2.0 * math.pi), is_prismatic=True)
    return Ratio(1.0 / float(entry.get("gear", 1.0)))


def _parse_pose(table: dict[str, Any]) -> dict[str, float]:
    revolute = {name: math.radians(value) for name, value in table.get("deg", {}).items()}
    return revolute | {name: float(value) for name, value in table.get("m", {}).items()}
