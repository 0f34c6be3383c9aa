"""Every error in an arm.toml is refused with its line or the path of the key."""

# ruff: noqa: E501 - one case a line

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from ikservo.errors import FileFormatError
from ikservo.model import catalogue
from ikservo.model.arm_file import read_arm_file


def refused(path: Path, content: str) -> FileFormatError:
    path.write_text(content)
    with pytest.raises(FileFormatError) as caught:
        read_arm_file(path)
    return caught.value


NAMES = "1 to 64 of the characters A-Z a-z 0-9 _ -"
IDS = "a whole number from 0 to 252"
PAYLOAD = "the heaviest payload that the servos are to lift, 0 to 5 kg"
BACKLASH = "degrees of free horn travel, 0 to 10"
TICKS = "a finite number, such as 2048"
EEPROM = "register = raw value, such as { drive_mode = 1 }"

# fmt: off
SLIPS = {
    "other format":        ("format = 1", "format = 2", "format", "is 2", "1"),
    "format is true":      ("format = 1", "format = true", "format", "is true", "1"),
    "format is 1.0":       ("format = 1", "format = 1.0", "format", "is 1.0", "1"),
    "no name":             ('name = "small"\n', "", "name", "is missing", NAMES),
    "name is a path":      ('name = "small"', 'name = "../small"', "name", 'is "../small"', NAMES),
    "name is too long":    ('name = "small"', f'name = "{"a" * 65}"', "name", f'is "{"a" * 59}…"', NAMES),
    "name ends a line":    ('name = "small"', r'name = "small\n"', "name", r"is 'small\n'", NAMES),
    "name is a number":    ('name = "small"', "name = 5", "name", "is 5", NAMES),
    "title in two lines":  ('"A small arm"', r'"A small\narm"', "title", r"is 'A small\narm'", "one line of text"),
    "key misspelled":      ("baud = ", "bauds = ", "bus.bauds", "is not a known key (and 1 more to correct)", "baud (known here: family, baud, supply_v)"),
    "key unheard of":      ("baud = ", "x = 1\nbaud = ", "bus.x", "is not a known key", "one of family, baud, supply_v"),
    "key at the top":      ("format = 1", "format = 1\nspeed = 2", "speed", "is not a known key",
                            "speeds (known here: format, name, title, urdf, tip, source, base_frame, base, payload_kg, bus, speeds, joints, poses, surroundings, health, calibration, gripper)"),
    "key of a servo":      ("zero_tick = 1024", "zero_tick = 1024, zero = 0", "joints[1].servo.zero", "is not a known key",
                            "zero_tick (known here: id, model, sign, zero_tick, eeprom, m_per_turn, crank, gear)"),
    "key of a pose":       ("[poses.home]\ndeg", "[poses.home]\nrad = {}\ndeg", "poses.home.rad", "is not a known key", "one of deg, m"),
    "key to be quoted":    ("baud = ", '"a b" = 1\nbaud = ', 'bus."a b"', "is not a known key", "one of family, baud, supply_v"),
    "no bus":              ('[bus]\nfamily = "dynamixel_2"\nbaud = 1_000_000', "", "bus", "is missing", "a table [bus]"),
    "bus is no table":     ('[bus]\nfamily = "dynamixel_2"\nbaud = 1_000_000', "bus = 1", "bus", "is 1", "a table [bus]"),
    "unknown family":      ('"dynamixel_2"', '"dynamixel"', "bus.family", 'is "dynamixel"', "feetech_sts, feetech_scs, dynamixel_2 or dynamixel_1"),
    "baud as text":        ("baud = 1_000_000", 'baud = "1M"', "bus.baud", 'is "1M"', "bits per second, such as 1_000_000"),
    "baud of zero":        ("baud = 1_000_000", "baud = 0", "bus.baud", "is 0", "bits per second, such as 1_000_000"),
    "no slow":             ("slow =", "slowly =", "speeds.slowly", "is not a known key (and 1 more to correct)", "slow (known here: slow, normal, fast)"),
    "speed of zero":       ("deg_s = 30.0", "deg_s = 0.0", "speeds.slow.deg_s", "is 0.0", "a speed above 0 deg/s"),
    "speed not a number":  ("deg_s = 30.0", "deg_s = nan", "speeds.slow.deg_s", "is nan", "a speed above 0 deg/s"),
    "negative payload":    ('name = "small"', 'name = "small"\npayload_kg = -0.1', "payload_kg", "is -0.1", PAYLOAD),
    "payload in grams":    ('name = "small"', 'name = "small"\npayload_kg = 250', "payload_kg", "is 250", PAYLOAD),
    "unknown role":        ('role = "gripper"', 'role = "hand"', "joints[2].role", 'is "hand"', "arm or gripper"),
    "id above 252":        ("id = 3", "id = 253", "joints[1].servo.id", "is 253", IDS),
    "negative id":         ("id = 3", "id = -1", "joints[1].servo.id", "is -1", IDS),
    "id is true":          ("id = 3", "id = true", "joints[1].servo.id", "is true", IDS),
    "id as text":          ("id = 3", 'id = "3"', "joints[1].servo.id", 'is "3"', IDS),
    "id with a fraction":  ("id = 3", "id = 3.0", "joints[1].servo.id", "is 3.0", IDS),
    "endless id":          ("id = 3", f"id = 0x{'f' * 9999}", "joints[1].servo.id", "is a huge number", IDS),
    "no id":               ("id = 3, ", "", "joints[1].servo.id", "is missing", IDS),
    "id of a shadow":      ("id = 2", "id = 300", "joints[0].shadows[0].id", "is 300", IDS),
    "shadows is no list":  ("shadows = [{", "shadows = {a = 1}\nx = [{", "joints[0].x", "is not a known key (and 1 more to correct)",
                            "one of name, role, zero_from, servo, backlash_deg, limits_deg, limits_m, shadows"),
    "negative backlash":   ('name = "elbow"', 'name = "elbow"\nbacklash_deg = -0.5', "joints[1].backlash_deg", "is -0.5", BACKLASH),
    "backlash of a turn":  ('name = "elbow"', 'name = "elbow"\nbacklash_deg = 360.0', "joints[1].backlash_deg", "is 360.0", BACKLASH),
    "sign of zero":        ("id = 3, model = \"XM430-W350\", sign = 1", "id = 3, model = \"XM430-W350\", sign = 0", "joints[1].servo.sign", "is 0", "1 or -1"),
    "sign is true":        ("sign = -1", "sign = true", "joints[0].servo.sign", "is true", "1 or -1"),
    "zero tick nan":       ("zero_tick = 1024", "zero_tick = nan", "joints[1].servo.zero_tick", "is nan", TICKS),
    "zero tick infinite":  ("zero_tick = 1024", "zero_tick = 1e999", "joints[1].servo.zero_tick", "is inf", TICKS),
    "zero tick is a date": ("zero_tick = 1024", "zero_tick = 1979-05-27", "joints[1].servo.zero_tick", "is 1979-05-27", TICKS),
    "servo is a list":     ("servo = { id = 3", "servo = []\nx = { id = 3", "joints[1].x", "is not a known key (and 1 more to correct)",
                            "one of name, role, zero_from, servo, backlash_deg, limits_deg, limits_m, shadows"),
    "slides backwards":    ("m_per_turn = 0.0722", "m_per_turn = -0.0722", "joints[2].servo.m_per_turn", "is -0.0722", "metres per turn, above 0"),
    "register with space": ("drive_mode = 0", '"drive mode" = 0', "joints[0].servo.eeprom", 'has the key "drive mode"', EEPROM),
    "register is true":    ("drive_mode = 0", "drive_mode = true", "joints[0].servo.eeprom.drive_mode", "is true", EEPROM),
    "register too large":  ("drive_mode = 0", "drive_mode = 0x1_0000_0000", "joints[0].servo.eeprom.drive_mode", "is 4294967296", EEPROM),
    "model with a space":  ('model = "XL430-W250"', 'model = "XL430 W250"', "joints[2].servo.model", 'is "XL430 W250"', 'a servo model, such as "XM430-W350"'),
    "pose is no table":    ("[poses.home]\n", "[poses]\nhalf = 1\n[poses.home]\n", "poses.half", "is 1", "tables [poses.NAME]"),
    "angle as text":       ("elbow = 45.0", 'elbow = "45"', "poses.home.deg.elbow", 'is "45"', "joint = degrees"),
    "angle infinite":      ("elbow = 45.0", "elbow = -inf", "poses.home.deg.elbow", "is -inf", "joint = degrees"),
    "one name twice":      ('name = "elbow"', 'name = "shoulder"', "joints[1].name", 'is "shoulder", the same as joints[0].name (and 3 more to correct)', "a unique name"),
    "one id twice":        ("id = 3", "id = 1", "joints[1].servo.id", "is 1, the same as joints[0].servo.id", "an id that is unique on the bus"),
    "id of a shadow again": ("id = 3", "id = 2", "joints[1].servo.id", "is 2, the same as joints[0].shadows[0].id", "an id that is unique on the bus"),
    "gripper in between":  ('name = "shoulder"\nrole = "arm"', 'name = "shoulder"\nrole = "gripper"', "joints[1].role", 'is "arm" after a gripper', "the gripper last"),
    "no rest":             ("[poses.rest]", "[poses.relax]", "poses.rest", "is missing", "the poses rest, home"),
    "joint left out":      (", elbow = 45.0", "", "poses.home", "leaves out elbow", "every joint once"),
    "joint misspelled":    ("elbow = 45.0", "elbwo = 45.0", "poses.home.deg.elbwo", "is not a joint (and 1 more to correct)", "elbow (joints: shoulder, elbow, gripper)"),
    "unknown joint":       ("elbow = 45.0", "elbow = 45.0, x = 0", "poses.home.deg.x", "is not a joint", "one of shoulder, elbow, gripper"),
    "degrees of a slide":  ("elbow = 45.0", "elbow = 45.0, gripper = 0.0", "poses.home.deg.gripper", "is a joint that slides (its servo has m_per_turn)", "metres, under m"),
    "metres of a turn":    ("gripper = 0.01", "gripper = 0.01, elbow = 0", "poses.home.m.elbow", "is a joint that turns (its servo has no m_per_turn)", "degrees, under deg"),
}
BROKEN = {
    "key twice":        ("format = 1", "format = 1\nformat = 1", "line 2, column 11"),
    "table twice":      ("[speeds]", "[bus]", "line 12, column 5"),
    "no value":         ("baud = 1_000_000", "baud =", "line 10, column 7"),
    "open string":      ('tip = "tip"', 'tip = "tip', "line 5, column 11"),
    "open bracket":     ("[bus]", "[bus", "line 8, column 5"),
    "leading zero":     ("id = 3", "id = 03", "line 28, column 17"),
    "impossible date":  ("baud = 1_000_000", "baud = 2026-02-30", "line 10, column 8"),
    "many dots":        ("format = 1", "format = 1\n" + ".".join("a" * 66) + " = 1", "line 2"),
    "null byte":        ("format = 1", "format = 1\n\0", "line 2, column 1"),
}
DOCUMENTS = {
    "empty":        ("", "", "is empty"),
    "comment":      ("# nothing\n", "format", "is missing (and 9 more to correct)"),
    "deep lists":   ("a = " + "[" * 9999, "", "tables are nested too deeply"),
    "deep tables":  ("a = " + "{a=" * 9999, "", "tables are nested too deeply"),
    "long number":  ("a = " + "1" * 9999, "", "holds a number that is too long"),
    "large":        ("a = 1\n" + "#" * 256 * 1024, "", "is too large"),
    "truncated":    ("joints = [", "end of document", "is not TOML: Invalid value"),
}
OUTSIDE = [
    "../arm.urdf", "../../etc/passwd", "/etc/passwd", "a/../../arm.urdf", "..", ".", "..\\arm.urdf",
    "C:\\arm.urdf", "file:///etc/passwd", "package://small/arm.urdf", "http://127.0.0.1/arm.urdf",
]
# fmt: on


@pytest.mark.parametrize(("old", "new", "where", "found", "expected"), SLIPS.values(), ids=SLIPS)
def test_arm_file_error_names_key_and_expected_value(
    arm_path: Path, arm_text: str, old: str, new: str, where: str, found: str, expected: str
) -> None:
    assert old in arm_text
    error = refused(arm_path, arm_text.replace(old, new, 1))
    assert (error.where, error.found, error.expected) == (where, found, expected)


@pytest.mark.parametrize(("old", "new", "where"), BROKEN.values(), ids=BROKEN)
def test_toml_syntax_error_is_reported_with_its_position(
    arm_path: Path, arm_text: str, old: str, new: str, where: str
) -> None:
    assert old in arm_text
    assert refused(arm_path, arm_text.replace(old, new, 1)).where == where


@pytest.mark.parametrize(("content", "where", "found"), DOCUMENTS.values(), ids=DOCUMENTS)
def test_invalid_document_is_refused(arm_path: Path, content: str, where: str, found: str) -> None:
    error = refused(arm_path, content)
    assert (error.where, error.found) == (where, found)


def test_arm_file_in_latin_1_is_refused_with_its_line(arm_path: Path) -> None:
    arm_path.write_bytes(b'format = 1\ntitle = "\xe9t\xe9"\n')
    with pytest.raises(FileFormatError, match=r"line 2: holds the byte 0xE9"):
        read_arm_file(arm_path)


def test_arm_file_pose_with_99_joints_in_one_line_is_refused(arm_path: Path, arm_text: str) -> None:
    pose = ", ".join(f"joint{i} = 1.5" for i in range(99))
    error = refused(arm_path, f"{arm_text}\n[poses.far]\ndeg = {{ {pose} }}\n")
    assert error.found == "has 99 values, such as joint angles"
    assert error.expected.startswith(
        "at most 64 in a line; write each joint of a pose in its own line"
    )


def test_arm_file_comment_with_many_dots_is_accepted(arm_path: Path, arm_text: str) -> None:
    arm_path.write_text(f"# {'.' * 100}\n{arm_text}")
    assert read_arm_file(arm_path).name == "small"


def test_arm_file_without_joints_is_refused(arm_path: Path, arm_text: str) -> None:
    head, tail = arm_text.split("[[joints]]", 1)[0], arm_text.split("[poses.rest]", 1)[1]
    error = refused(arm_path, f"joints = []\n{head}[poses.rest]{tail}")
    assert (error.where, error.expected) == ("joints", "at least one")


@pytest.mark.parametrize("urdf", OUTSIDE)
def test_arm_file_with_urdf_outside_folder_is_refused(
    arm_path: Path, arm_text: str, urdf: str
) -> None:
    error = refused(arm_path, arm_text.replace("'", '"').replace('"arm.urdf"', f"'{urdf}'"))
    assert (error.where, error.expected) == ("urdf", "a file in the arm's own folder")


def test_urdf_symlink_out_of_folder_is_refused(
    arm_path: Path, arm_text: str, urdf_path: Path, tmp_path: Path
) -> None:
    urdf_path.rename(tmp_path / "elsewhere.urdf")
    urdf_path.symlink_to(tmp_path / "elsewhere.urdf")
    assert refused(arm_path, arm_text).where == "urdf"


def test_arm_name_in_catalogue_must_equal_its_folder(
    arm_path: Path, arm_text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(catalogue, "__file__", str(tmp_path / "ikservo/model/catalogue.py"))
    folder = shutil.copytree(arm_path.parent, tmp_path / "configs" / "small")
    error = refused(folder / "arm.toml", arm_text.replace('name = "small"', 'name = "large"', 1))
    assert (error.where, error.found) == ("name", 'is "large"')


def test_arm_file_error_text_names_file_key_and_expected_value(
    arm_path: Path, arm_text: str
) -> None:
    error = refused(arm_path, arm_text.replace("id = 3", "id = 300"))
    assert str(error) == f"{arm_path}, joints[1].servo.id: is 300.\nExpected {IDS}."
