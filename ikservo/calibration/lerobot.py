"""LeRobot's calibration JSON: reading, writing, and LeRobot's storage folders.

Ranges are in *homed* ticks, as the servo reports them with its offset. LeRobot's degrees are
``(tick - (min + max) / 2) * 360 / 4095``: zero is the middle of the recorded range, not the zero of
the geometry. Therefore, an import gives ids and ranges, and the user sets the zero.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from ikservo.calibration.records import Calibration
from ikservo.errors import FileFormatError, InputError, UnknownNameError
from ikservo.files.reading import parse_json, read_text

_MAX_BYTES = 64 * 1024
_KEYS = ("id", "drive_mode", "homing_offset", "range_min", "range_max")
_MAX_DIGITS = 100
_FULL_TURN = (0, 4095)
_OLD_KEYS = {"motor_names", "start_pos", "calib_mode"}


@dataclass(frozen=True, slots=True)
class LerobotJoint:
    """One joint in the file, with LeRobot's keys."""

    name: str
    id: int
    drive_mode: int
    homing_offset: int
    range_min: int
    range_max: int

    @property
    def is_continuous(self) -> bool:
        """Whether the range is a full revolution."""
        return (self.range_min, self.range_max) == _FULL_TURN


def read_lerobot(path: Path) -> tuple[LerobotJoint, ...]:
    """Read a LeRobot calibration.

    Raises:
        FileFormatError: The file is not a LeRobot calibration.
    """
    return parse_lerobot(path, read_text(path, _MAX_BYTES))


def parse_lerobot(path: Path, text: str) -> tuple[LerobotJoint, ...]:
    """Parse the joints from text in the order of the file; ``path`` is for messages."""
    try:
        table = parse_json(text, _parse_integer)
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise FileFormatError(path, where, f"is not JSON: {error.msg.lower()}") from error
    except RecursionError as error:
        raise FileFormatError(path, "", "tables are nested too deeply") from error
    except ValueError as error:
        raise FileFormatError(path, "", f"is not a calibration: {error}") from error
    if not isinstance(table, dict) or not table:
        raise FileFormatError(path, "", "is not a table of joints", "joint: {id, drive_mode, …}")
    joints = cast("Mapping[str, object]", table)
    if _OLD_KEYS & joints.keys():
        expected = "a newer one; calibrate again with LeRobot, or with: ikservo calibrate"
        raise FileFormatError(path, "", "is a calibration from LeRobot before mid-2025", expected)
    found = tuple(_parse_joint(path, name, row) for name, row in joints.items())
    ids = [joint.id for joint in found]
    for joint in found:
        if ids.count(joint.id) > 1:
            where = f"{_printable_name(joint.name)}.id"
            raise FileFormatError(path, where, f"repeats {joint.id}", "a unique id")
    return found


def dump_lerobot(joints: Sequence[LerobotJoint]) -> str:
    """Format the file's text as LeRobot does: indent 4, no newline at the end."""
    table = {joint.name: {key: getattr(joint, key) for key in _KEYS} for joint in joints}
    return json.dumps(table, indent=4)


def lerobot_joints(calibration: Calibration) -> tuple[LerobotJoint, ...]:
    """Return a calibration as LeRobot joints; ``lost_in_lerobot`` lists the data that are lost."""
    joints: list[LerobotJoint] = []
    for joint in calibration.joints:
        low, high = joint.travel_ticks if joint.swept != "not swept" else _FULL_TURN
        servo_id, holds = joint.servo.id, joint.servo.holds
        reverse, offset = holds.get("drive_mode", 0) & 1, holds.get("homing_offset", 0)
        joints.append(LerobotJoint(joint.name, servo_id, reverse, offset, low, high))
    return tuple(joints)


def lost_in_lerobot(calibration: Calibration) -> Iterator[str]:
    """Yield the parts of a calibration that LeRobot's file cannot represent, one line each."""
    yield "LeRobot uses the middle of each range as zero; its file cannot hold other zeros."
    for joint in calibration.joints:
        if joint.sign == -1:
            yield f"{joint.name}'s servo counts opposite to its joint, as do LeRobot's degrees."
        if joint.swept == "not swept":
            yield f"{joint.name} was not swept; LeRobot's file gets a full turn."
        if joint.extended and joint.swept != "not swept":
            yield f"{joint.name} counts beyond one turn, which LeRobot's range cannot represent."
        if any(end is not None for end in joint.user_range()):
            yield f"Your own limits of {joint.name} are not in LeRobot's file."
        for shadow in joint.shadows:
            yield f"Servo {shadow.id} of {joint.name} is left out: LeRobot has one servo per joint."
    if calibration.geometry:
        yield "The link and base corrections from a touch-off are left out."


def _parse_integer(digits: str) -> int:
    if len(digits) > _MAX_DIGITS:
        raise ValueError("a number is too long")
    return int(digits)


def _parse_joint(path: Path, name: str, row: object) -> LerobotJoint:
    shown = _printable_name(name)
    if not isinstance(row, dict):
        raise FileFormatError(path, shown, "is not a table", ", ".join(_KEYS))
    values = cast("dict[str, object]", row)
    for key in _KEYS:
        if key not in values:
            raise FileFormatError(path, f"{shown}.{key}", "is missing", ", ".join(_KEYS))
    for key in values:
        if key not in _KEYS:
            raise FileFormatError(
                path, f"{shown}.{_printable_name(key)}", "is unknown", ", ".join(_KEYS)
            )
    numbers: dict[str, int] = {}
    for key in _KEYS:
        value = values[key]
        if type(value) is not int or abs(value) > 2**20:
            expected = "a whole number: ticks or an id"
            raise FileFormatError(path, f"{shown}.{key}", "is not a whole number", expected)
        numbers[key] = value
    joint = LerobotJoint(name, **numbers)
    if not joint.range_min < joint.range_max:
        found = f"is {joint.range_min}, not below {joint.range_max}"
        raise FileFormatError(path, f"{shown}.range_min", found, "range_min < range_max")
    return joint


def _printable_name(name: str) -> str:
    """Return a name for a message: short, and without control characters."""
    return name[:64] if name[:64].isprintable() else ascii(name[:64])


_ID = re.compile(r"[A-Za-z0-9_-]{1,64}")
_KINDS = ("robots", "teleoperators")


def find_lerobot(id_or_path: str) -> Path:
    """Find the calibration file for an id or a path.

    Ids are searched below ``robots/<type>`` and ``teleoperators/<type>`` for every type, because
    LeRobot has renamed them: so100_follower, so101_follower, now so_follower.

    Raises:
        UnknownNameError: There is no such id; the existing ids are listed.
        InputError: Several devices have that id; their files are listed.
    """
    if not _ID.fullmatch(id_or_path):
        return Path(id_or_path)
    found = [path for path in _list_files() if path.stem == id_or_path]
    if not found:
        raise UnknownNameError("LeRobot calibration", id_or_path, {p.stem for p in _list_files()})
    if len(found) > 1:
        listing = ", ".join(map(str, found))
        raise InputError(f"Several devices are called {id_or_path}.", f"Name one file: {listing}.")
    return found[0]


def lerobot_roots() -> list[Path]:
    """Return the folders in which LeRobot may store calibrations, the most specific first."""
    own, home, hub = map(os.environ.get, ("HF_LEROBOT_CALIBRATION", "HF_LEROBOT_HOME", "HF_HOME"))
    roots = [Path(own)] if own else []
    roots += [Path(home) / "calibration"] if home else []
    roots += [Path(hub) / "lerobot" / "calibration"] if hub else []
    return [*roots, Path.home() / ".cache" / "huggingface" / "lerobot" / "calibration"]


def _list_files() -> Iterator[Path]:
    seen: set[Path] = set()
    for root in lerobot_roots():
        for kind in _KINDS:
            for path in sorted((root / kind).glob("*/*.json")):
                if path.resolve() not in seen and _ID.fullmatch(path.stem):
                    seen.add(path.resolve())
                    yield path
