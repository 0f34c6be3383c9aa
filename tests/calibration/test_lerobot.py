"""LeRobot's calibrations are found, checked, read and exported."""

import json
import random
from datetime import UTC, datetime
from pathlib import Path

import pytest

from ikservo.calibration.lerobot import (
    LerobotJoint,
    dump_lerobot,
    find_lerobot,
    lerobot_joints,
    lost_in_lerobot,
    parse_lerobot,
    read_lerobot,
)
from ikservo.errors import FileFormatError, IkservoError, InputError, UnknownNameError
from tests.calibration.factories import make_calibration
from tests.calibration.mounted_arms import make_mounted_arm
from tests.calibration.records import calibration_of, joint
from tests.calibration.test_calibration_file import GEOMETRY

ROW = {"id": 1, "drive_mode": 0, "homing_offset": -1043, "range_min": 750, "range_max": 3450}
TABLE = {"shoulder_pan": ROW, "gripper": {**ROW, "id": 6, "homing_offset": 2047}}
CAMPAIGN = (pytest.mark.campaign, pytest.mark.timeout(1200))
TEXT = json.dumps(TABLE, indent=4)


@pytest.fixture(autouse=True)
def _no_lerobot(tmp_path, monkeypatch):
    for name in ("HF_LEROBOT_CALIBRATION", "HF_LEROBOT_HOME", "HF_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(Path, "home", lambda: tmp_path)


def put(root, kind, name="black"):
    path = root / "robots" / kind / f"{name}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(TEXT)
    return path


def test_lerobot_file_survives_parse_and_dump_byte_for_byte():
    assert dump_lerobot(parse_lerobot(Path("x.json"), TEXT)) == TEXT


def test_lerobot_file_keeps_its_joint_order():
    joints = parse_lerobot(Path("x.json"), TEXT)
    assert [(j.name, j.id, j.homing_offset) for j in joints] == [
        ("shoulder_pan", 1, -1043), ("gripper", 6, 2047),
    ]  # fmt: skip


@pytest.mark.parametrize(
    "kind", ["so_follower", "so100_follower", "so101_follower", "koch_follower"]
)
def test_lerobot_id_is_found_under_every_past_type_name(tmp_path, kind):
    path = put(tmp_path / ".cache/huggingface/lerobot/calibration", kind)
    assert find_lerobot("black") == path


@pytest.mark.parametrize(("name", "below"), [
    ("HF_LEROBOT_CALIBRATION", ""), ("HF_LEROBOT_HOME", "calibration"),
    ("HF_HOME", "lerobot/calibration"),
])  # fmt: skip
def test_lerobot_folder_is_taken_from_environment(tmp_path, monkeypatch, name, below):
    monkeypatch.setenv(name, str(tmp_path / "elsewhere"))
    path = put(tmp_path / "elsewhere" / below, "so_follower")
    assert find_lerobot("black") == path


def test_lerobot_leader_calibration_is_found(tmp_path):
    path = tmp_path / ".cache/huggingface/lerobot/calibration/teleoperators/so_leader/blue.json"
    path.parent.mkdir(parents=True)
    path.write_text(TEXT)
    assert find_lerobot("blue") == path


def test_lerobot_id_of_two_devices_is_refused_as_ambiguous(tmp_path):
    root = tmp_path / ".cache/huggingface/lerobot/calibration"
    put(root, "so_follower"), put(root, "so101_follower")
    with pytest.raises(InputError, match=r"(?s)Several devices.*so101_follower.*so_follower"):
        find_lerobot("black")


def test_lerobot_folder_given_by_two_variables_is_used_once(tmp_path, monkeypatch):
    monkeypatch.setenv("HF_LEROBOT_HOME", str(tmp_path / "own"))
    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", str(tmp_path / "own" / "calibration"))
    path = put(tmp_path / "own" / "calibration", "so_follower")
    assert find_lerobot("black") == path


def test_lerobot_file_not_named_by_an_id_is_not_suggested(tmp_path):
    root = tmp_path / ".cache/huggingface/lerobot/calibration"
    put(root, "so_follower"), put(root, "so_follower", "black (copy)")
    with pytest.raises(UnknownNameError) as caught:
        find_lerobot("blackk")
    assert "copy" not in str(caught.value) + caught.value.hint


def test_unknown_lerobot_id_error_suggests_closest_id(tmp_path):
    put(tmp_path / ".cache/huggingface/lerobot/calibration", "so_follower")
    with pytest.raises(UnknownNameError, match="Did you mean black"):
        find_lerobot("blackk")


@pytest.mark.parametrize("name", ["../black", "a/b", "black.json", "~/black", "a b", "x" * 65])
def test_lerobot_argument_that_is_not_an_id_is_taken_as_path(name):
    assert find_lerobot(name) == Path(name)


SPOILED = {
    "no JSON": ("{", "is not JSON"),
    "a list": ("[]", "table of joints"),
    "no joints": ("{}", "table of joints"),
    "a joint that is a number": ('{"elbow": 3}', "is not a table"),
    "a key left out": (TEXT.replace('"drive_mode": 0,', "", 1), "is missing"),
    "a key too many": (TEXT.replace('"drive_mode"', '"offset": 1, "drive_mode"', 1), "is unknown"),
    "a text for a number": (TEXT.replace("-1043", '"-1043"'), "not a whole number"),
    "half a tick": (TEXT.replace("-1043", "-1043.5"), "not a whole number"),
    "true for a number": (TEXT.replace("-1043", "true"), "not a whole number"),
    "not a number": (TEXT.replace("-1043", "NaN"), "it contains NaN"),
    "infinity": (TEXT.replace("-1043", "1e999"), "not a whole number"),
    "more ticks than any servo has": (
        TEXT.replace("-1043", str(-(2**20) - 1)),
        "not a whole number",
    ),
    "a range of one tick": (TEXT.replace("750", "3450", 1), "not below"),
    "a huge number": (TEXT.replace("-1043", "9" * 30), "not a whole number"),
    "digits without end": (TEXT.replace("-1043", "9" * 5000), "a number is too long"),
    "a name for the terminal": ('{"\\u001b[31m": {"id": 1}}', "is missing"),
    "a joint twice": (TEXT.replace('"gripper"', '"shoulder_pan"'), "twice"),
    "an id twice": (TEXT.replace('"id": 6', '"id": 1'), "repeats 1"),
    "a range turned over": (TEXT.replace("750", "3451", 1), "not below"),
    "nested too deep": ("[" * 60_000, "too deep"),
    "of before mid-2025": (
        '{"motor_names": ["a"], "start_pos": [1], "calib_mode": []}',
        "mid-2025",
    ),
}


@pytest.mark.parametrize(("text", "found"), SPOILED.values(), ids=SPOILED)
def test_damaged_lerobot_file_gives_one_clear_error(tmp_path, text, found):
    path = tmp_path / "black.json"
    path.write_text(text)
    with pytest.raises(FileFormatError) as caught:
        read_lerobot(path)
    assert found in caught.value.message
    assert caught.value.message.isprintable()


@pytest.mark.parametrize("count", [400, pytest.param(100_000, marks=CAMPAIGN)])
def test_mutated_lerobot_calibration_is_read_or_refused(tmp_path, count):
    chance, path = random.Random(5), tmp_path / "black.json"
    for _ in range(count):
        data = bytearray(TEXT.encode())
        for _ in range(chance.randint(1, 3)):
            data[chance.randrange(len(data))] = chance.randrange(256)
        path.write_bytes(data)
        try:
            joints = read_lerobot(path)
        except IkservoError:
            continue
        assert all(joint.range_min < joint.range_max for joint in joints)


def test_lerobot_error_truncates_names_and_escapes_control_bytes():
    for name, shown in (
        ("e" * 80, "e" * 64),
        ("\x07" + "e" * 80, ascii("\x07" + "e" * 63)),
        ("e" * 63 + "\x07", ascii("e" * 63 + "\x07")),
        ("e" * 64 + "\x07", "e" * 64),
    ):
        with pytest.raises(FileFormatError) as caught:
            parse_lerobot(Path("x.json"), json.dumps({name: 3}))
        assert caught.value.where == shown


def test_lerobot_homing_offset_of_minus_2_power_20_is_accepted():
    text = TEXT.replace("-1043", str(-(2**20)))
    assert parse_lerobot(Path("x.json"), text)[0].homing_offset == -(2**20)


@pytest.mark.parametrize(("digits", "found"), [(100, "not a whole number"), (101, "too long")])
def test_lerobot_file_number_above_100_digits_is_refused(digits, found):
    with pytest.raises(FileFormatError, match=found):
        parse_lerobot(Path("x.json"), TEXT.replace("-1043", "9" * digits))


@pytest.mark.parametrize("range_max", [4095, 4094])
def test_lerobot_range_of_whole_turn_means_continuous_joint(range_max):
    row = {**ROW, "range_min": 0, "range_max": range_max}
    (found,) = parse_lerobot(Path("x.json"), json.dumps({"wrist": row}))
    assert found.is_continuous == (range_max == 4095)


def test_lerobot_export_has_registers_and_swept_range():
    swept = joint(holds={"homing_offset": -7})
    free = joint("wrist", 2, swept="not swept", lower_deg=None, upper_deg=None)
    assert lerobot_joints(calibration_of(swept, free)) == (
        LerobotJoint("elbow", 1, 0, -7, 1000, 3000),
        LerobotJoint("wrist", 2, 0, 0, 0, 4095),
    )


@pytest.mark.parametrize(("mode", "reverse"), [(0, 0), (1, 1), (4, 0), (5, 1)])
def test_lerobot_export_keeps_only_direction_bit_of_drive_mode(mode, reverse):
    turned = joint(model="XM430-W350", holds={"drive_mode": mode})
    assert lerobot_joints(calibration_of(turned))[0].drive_mode == reverse


def test_lerobot_export_of_servo_without_offset_has_zero():
    (found,) = lerobot_joints(calibration_of(joint(model="SCS15", travel_ticks=[100, 900])))
    assert (found.homing_offset, found.drive_mode) == (0, 0)


ZEROS = "LeRobot uses the middle of each range as zero; its file cannot hold other zeros."
UNSWEPT = {"swept": "not swept", "lower_deg": None, "upper_deg": None}


@pytest.mark.parametrize(
    ("changes", "warning"),
    [
        ({}, []),
        ({"sign": -1}, ["elbow's servo counts opposite to its joint, as do LeRobot's degrees."]),
        (UNSWEPT, ["elbow was not swept; LeRobot's file gets a full turn."]),
        ({**UNSWEPT, "extended": True}, ["elbow was not swept; LeRobot's file gets a full turn."]),
        (
            {"extended": True},
            ["elbow counts beyond one turn, which LeRobot's range cannot represent."],
        ),
        ({"user_lower_deg": 3.0}, ["Your own limits of elbow are not in LeRobot's file."]),
        ({"user_upper_deg": 3.0}, ["Your own limits of elbow are not in LeRobot's file."]),
    ],
)
def test_lerobot_export_warns_of_lost_values_per_joint(changes, warning):
    assert [*lost_in_lerobot(calibration_of(joint(**changes)))] == [ZEROS, *warning]


def test_lerobot_export_warns_of_second_servo_and_touch_off(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    arm = make_mounted_arm("vx300s", 3, spoiled=False)
    with arm.open_limp() as limp_arm:
        calibration = make_calibration(arm, limp_arm, datetime(2026, 11, 2, tzinfo=UTC))
    warning = "\n".join(lost_in_lerobot(calibration.model_copy(update={"geometry": GEOMETRY})))
    assert "Servo 3 of shoulder is left out" in warning
    assert "from a touch-off are left out" in warning
