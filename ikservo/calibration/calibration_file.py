"""The calibration file: TOML with a checksum, consistency checks and storage."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, cast

from ikservo.calibration.homing import MAX_STS_OFFSET, MAX_X_OFFSET
from ikservo.calibration.joint_limits import MIN_RANGE_TICKS
from ikservo.calibration.joint_map import encoder_of
from ikservo.calibration.paths import calibration_path
from ikservo.calibration.records import CalibratedJoint, CalibratedServo, Calibration
from ikservo.calibration.servo_config import calibration_registers
from ikservo.errors import FileFormatError, InputError
from ikservo.files.reading import MAX_BYTES, parse_toml, quote, read_text, require_file
from ikservo.files.validation import Location, ValidationIssue, first_issue
from ikservo.files.writing import (
    BACKUP_SUFFIX,
    checked_toml,
    exclusive_access,
    strip_checksum,
    write_atomic,
)
from ikservo.registers import MODELS, Family


def inconsistencies(calibration: Calibration) -> Iterator[ValidationIssue]:
    """Yield each contradiction between values, in the order of the file."""
    if calibration.written.tzinfo is None:
        yield ValidationIssue(
            ("written",), "has no UTC offset", "a time such as 2026-11-02T14:03:22Z"
        )
    yield from _check_geometry(calibration)
    names = [joint.name for joint in calibration.joints]
    for i, name in enumerate(names):
        if name in names[:i]:
            yield ValidationIssue(("joints", i, "name"), f"repeats {quote(name)}", "a unique name")
    ids: set[int] = set()
    for i, joint in enumerate(calibration.joints):
        for servo in joint.servos:
            if servo.id in ids:
                where = ("joints", i, "servo", "id")
                yield ValidationIssue(where, f"repeats {servo.id}", "a unique id")
            ids.add(servo.id)
    for i, joint in enumerate(calibration.joints):
        for servo in joint.servos:
            yield from _check_servo(("joints", i, "servo"), servo, calibration.family)
        yield from _check_travel(("joints", i), joint)
        yield from _check_range(("joints", i), joint)


def _check_geometry(calibration: Calibration) -> Iterator[ValidationIssue]:
    geometry = calibration.geometry
    if geometry is None:
        return
    if geometry.touched.tzinfo is None:
        expected = "a time such as 2026-11-02T14:03:22Z"
        yield ValidationIssue(("geometry", "touched"), "has no UTC offset", expected)
    names = [origin.joint for origin in geometry.origins]
    for i, name in enumerate(names):
        if name in names[:i]:
            where = ("geometry", "origins", i, "joint")
            yield ValidationIssue(where, f"repeats {quote(name)}", "each joint once")


def _check_servo(where: Location, servo: CalibratedServo, family: str) -> Iterator[ValidationIssue]:
    table = MODELS.get(servo.model)
    if table is None or table.family != family:
        known = ", ".join(name for name, t in MODELS.items() if t.family == family)
        yield ValidationIssue((*where, "model"), f"is {quote(servo.model)}", f"one of: {known}")
        return
    for name, number in servo.holds.items():
        if name not in table.registers:
            yield ValidationIssue(
                (*where, "holds", name), "is not a register", f"a register of {table.model_name}"
            )
        elif not table.registers[name].range[0] <= number <= table.registers[name].range[1]:
            low, high = table.registers[name].range
            yield ValidationIssue((*where, "holds", name), f"is {number}", f"{low} to {high}")
    for register in calibration_registers(table):
        if register.name not in servo.holds:
            yield ValidationIssue(
                (*where, "holds", register.name), "is missing", "the number that the servo held"
            )


def _check_travel(where: Location, joint: CalibratedJoint) -> Iterator[ValidationIssue]:
    table = MODELS.get(joint.servo.model)
    if table is None:
        return
    low, high = joint.travel_ticks
    encoder = encoder_of(table)
    if not MIN_RANGE_TICKS <= high - low < encoder.ticks:
        found = f"is [{low}, {high}]"
        yield ValidationIssue(
            (*where, "travel_ticks"), found, f"{MIN_RANGE_TICKS} to {encoder.ticks - 1} ticks apart"
        )
    elif not joint.extended and (low < 0 or high >= encoder.ticks):
        found = f"is [{low}, {high}]"
        yield ValidationIssue(
            (*where, "travel_ticks"), found, f"ticks from 0 to {encoder.ticks - 1}"
        )
    max_offsets = {Family.FEETECH_STS: MAX_STS_OFFSET, Family.DYNAMIXEL_2: MAX_X_OFFSET}
    max_offset, offset = max_offsets.get(table.family), joint.servo.holds.get("homing_offset", 0)
    if max_offset is not None and not joint.extended and abs(offset) > max_offset:
        location = (*where, "servo", "holds", "homing_offset")
        yield ValidationIssue(location, f"is {offset}", f"-{max_offset} to {max_offset}")


def _check_range(where: Location, joint: CalibratedJoint) -> Iterator[ValidationIssue]:
    swept = joint.recorded_range()
    if (swept is None) != (joint.swept == "not swept"):
        expected = "both limits if swept, otherwise no limits"
        yield ValidationIssue((*where, "swept"), f"is {quote(joint.swept)}", expected)
    elif swept and not swept[0] < swept[1]:
        yield ValidationIssue(
            (*where, "lower_deg"), "is not below the upper limit", "lower < upper"
        )


FORMAT = 1
_HEADER = """\
# The calibration of one arm, written by ikservo. It belongs to this arm's own servos, and every
# change must go through `ikservo calibrate`: the checksum above covers every byte below.
"""


def dump_calibration(calibration: Calibration) -> str:
    """Format a calibration as the text of its file."""
    tables = _plain_tables(calibration.model_dump(mode="python", exclude_none=True))
    for joint in tables["joints"]:  # for a rigid joint, the format of old files is kept
        for name in [name for name in ("compliance", "play_deg") if joint[name] == 0.0]:
            del joint[name]
    if not tables["cameras"]:  # then the format of old files is kept
        del tables["cameras"]
    return checked_toml(_HEADER, tables)


def read_calibration(path: Path) -> Calibration:
    """Read and check a calibration file.

    Raises:
        FileFormatError: The file is damaged, not a calibration or in a different format.
    """
    return parse_calibration(path, read_text(path, MAX_BYTES))


def parse_calibration(path: Path, text: str) -> Calibration:
    """Parse a calibration from text; ``path`` is its origin, for messages."""
    tables = parse_toml(path, strip_checksum(path, text))
    found = tables.get("format")
    if isinstance(found, int) and not isinstance(found, bool) and found > FORMAT:
        expected = f"format {FORMAT}; a newer ikservo wrote this, so update ikservo"
        raise FileFormatError(path, "format", f"is {found}", expected)
    calibration = Calibration.from_tables(tables, path)
    issues = list(inconsistencies(calibration))
    if issues:
        raise first_issue(issues, path)
    return calibration


def _plain_tables(value: Any) -> Any:  # noqa: ANN401  # tables of tables
    """Convert tables for the TOML writer: tuples become lists; empty tuples are left out."""
    if isinstance(value, Mapping):
        rows = cast("Mapping[str, Any]", value)
        return {key: _plain_tables(item) for key, item in rows.items() if item != ()}
    if isinstance(value, tuple):
        return [_plain_tables(item) for item in cast("tuple[Any, ...]", value)]
    return value


def load_calibration(arm: str, usb_serial_number: str) -> Calibration | None:
    """Load the calibration of an arm on an adapter; return None if it has no calibration.

    Raises:
        FileFormatError: The file is damaged; the message says what to do.
    """
    return load_calibration_file(calibration_path(arm, usb_serial_number), arm)


def load_calibration_file(path: Path, arm: str) -> Calibration | None:
    """Load an arm's calibration from a file; return None if there is no such file.

    Raises:
        FileFormatError: The file is damaged; the message says what to do.
    """
    if not path.exists():
        return None
    try:
        return read_calibration(path)
    except FileFormatError as error:
        expected = f"{error.expected or 'a calibration'}. {ways_out(path, arm)}"
        raise FileFormatError(path, error.where, error.found, expected) from error


def ways_out(path: Path, arm: str) -> str:
    """Return advice for a calibration that cannot be used."""
    restore = f"Restore the previous one: ikservo calibration restore {arm}. Or c"
    again = f"alibrate again: ikservo calibrate {arm}. To switch torque off: ikservo relax"
    return f"{restore if backup_path(path).is_file() else 'C'}{again} --arm {arm}"


def backup_path(path: Path) -> Path:
    """Return the file that keeps the previous content of a calibration."""
    return path.with_name(path.name + BACKUP_SUFFIX)


def restore_calibration(path: Path) -> Calibration:
    """Replace a damaged calibration with the previous one; the damaged file is kept as .damaged.

    Raises:
        FileFormatError: There is no previous calibration, or it cannot be used.
        InputError: The present calibration is not damaged.
        FileWriteError: The file cannot be written.
    """
    backup = backup_path(path)
    text = read_text(backup, MAX_BYTES)
    calibration = parse_calibration(backup, text)
    with exclusive_access(path):
        if path.exists() and not _keep_damaged(path):
            raise InputError(f"{path} is not damaged; nothing was restored.", "")
        write_atomic(path, text)
    return calibration


def replace_calibration(path: Path, text: str) -> None:
    """Write the file; a valid previous file is kept as .bak, a damaged one as .damaged.

    Raises:
        FileWriteError: The file cannot be written; the previous file is unchanged.
    """
    with exclusive_access(path):
        write_atomic(path, text, keep_old=path.exists() and not _keep_damaged(path))


def _keep_damaged(path: Path) -> bool:
    """If a calibration is damaged, copy its file to a second one; return whether it is damaged."""
    try:
        read_calibration(path)
    except FileFormatError:
        require_file(path)
        write_atomic(path.with_name(f"{path.name}.damaged"), path.read_bytes()[:MAX_BYTES])
        return True
    return False


def undo_calibration(path: Path) -> Calibration:
    """Exchange the present calibration of an arm with the previous calibration.

    Raises:
        FileFormatError: There is no previous calibration, or one of the two is damaged.
        InputError: Servo registers differ between the calibrations, and a file cannot restore them.
        FileWriteError: The files cannot be written.
    """
    backup = backup_path(path)
    with exclusive_access(path):
        before, now = read_calibration(backup), read_calibration(path)
        held = [
            [servo for joint in each.joints for servo in joint.servos] for each in (before, now)
        ]
        if held[0] != held[1]:
            hint = f"Write this file's values into the servos: ikservo calibration push {now.arm}"
            raise InputError(f"The register values have changed since {backup} was made.", hint)
        write_atomic(path, dump_calibration(before), keep_old=True)
    return before


def save_calibration(calibration: Calibration) -> Path:
    """Write a calibration to its file; the previous file is kept as a backup.

    Raises:
        FileWriteError: The file cannot be written; the previous file is unchanged.
    """
    path = calibration_path(calibration.arm, calibration.usb_serial_number)
    replace_calibration(path, dump_calibration(calibration))
    return path
