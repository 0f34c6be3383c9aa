"""LeRobot's calibrations are found where it keeps them, read with suspicion, and handed back."""

import json
import random
from datetime import UTC, datetime
from pathlib import Path

import pytest

from ikservo.calibration.filing.lerobot import dump_lerobot, parse_lerobot, read_lerobot, unsaid
from ikservo.calibration.filing.lerobot_places import find_lerobot
from ikservo.errors import FileFormatError, IkservoError, InputError, UnknownNameError
from tests.calibration.hidden import hidden_arm
from tests.calibration.plain import plain_calibration
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


def test_a_text_of_lerobot_comes_back_byte_for_byte():
    assert dump_lerobot(parse_lerobot(Path("x.json"), TEXT)) == TEXT


def test_the_file_is_read_in_its_own_order():
    joints = parse_lerobot(Path("x.json"), TEXT)
    assert [(j.name, j.id, j.homing_offset) for j in joints] == [
        ("shoulder_pan", 1, -1043), ("gripper", 6, 2047),
    ]  # fmt: skip


@pytest.mark.parametrize(
    "kind", ["so_follower", "so100_follower", "so101_follower", "koch_follower"]
)
def test_an_id_is_found_under_every_name_that_the_type_has_had(tmp_path, kind):
    path = put(tmp_path / ".cache/huggingface/lerobot/calibration", kind)
    assert find_lerobot("black") == path


@pytest.mark.parametrize(("name", "below"), [
    ("HF_LEROBOT_CALIBRATION", ""), ("HF_LEROBOT_HOME", "calibration"),
    ("HF_HOME", "lerobot/calibration"),
])  # fmt: skip
def test_the_environment_says_where_lerobot_lives(tmp_path, monkeypatch, name, below):
    monkeypatch.setenv(name, str(tmp_path / "elsewhere"))
    path = put(tmp_path / "elsewhere" / below, "so_follower")
    assert find_lerobot("black") == path


def test_a_leaders_calibration_is_found_as_well(tmp_path):
    path = tmp_path / ".cache/huggingface/lerobot/calibration/teleoperators/so_leader/blue.json"
    path.parent.mkdir(parents=True)
    path.write_text(TEXT)
    assert find_lerobot("blue") == path


def test_two_devices_of_one_id_must_be_told_apart(tmp_path):
    root = tmp_path / ".cache/huggingface/lerobot/calibration"
    put(root, "so_follower"), put(root, "so101_follower")
    with pytest.raises(InputError, match=r"(?s)Several devices.*so101_follower.*so_follower"):
        find_lerobot("black")


def test_an_unknown_id_offers_the_closest(tmp_path):
    put(tmp_path / ".cache/huggingface/lerobot/calibration", "so_follower")
    with pytest.raises(UnknownNameError, match="Did you mean black"):
        find_lerobot("blackk")


@pytest.mark.parametrize("name", ["../black", "a/b", "black.json", "~/black", "a b", "x" * 65])
def test_what_is_no_id_is_a_path(name):
    assert find_lerobot(name) == Path(name)


SPOILED = {
    "no JSON": ("{", "is not JSON"),
    "a list": ("[]", "table of joints"),
    "no joints": ("{}", "table of joints"),
    "a joint that is a number": ('{"elbow": 3}', "is not a table"),
    "a key left out": (TEXT.replace('"drive_mode": 0,', "", 1), "is missing"),
    "a key too many": (TEXT.replace('"drive_mode"', '"offset": 1, "drive_mode"', 1), "is unknown"),
    "a text for a number": (TEXT.replace("-1043", '"-1043"'), "no whole number"),
    "half a tick": (TEXT.replace("-1043", "-1043.5"), "no whole number"),
    "true for a number": (TEXT.replace("-1043", "true"), "no whole number"),
    "not a number": (TEXT.replace("-1043", "NaN"), "NaN stands in it"),
    "infinity": (TEXT.replace("-1043", "1e999"), "no whole number"),
    "a huge number": (TEXT.replace("-1043", "9" * 30), "no whole number"),
    "digits without end": (TEXT.replace("-1043", "9" * 5000), "a number is too long"),
    "a name for the terminal": ('{"\\u001b[31m": {"id": 1}}', "is missing"),
    "a joint twice": (TEXT.replace('"gripper"', '"shoulder_pan"'), "twice"),
    "an id twice": (TEXT.replace('"id": 6', '"id": 1'), "second time"),
    "a range turned over": (TEXT.replace("750", "3451", 1), "not below"),
    "nested too deep": ("[" * 100_000, ""),
    "of before mid-2025": (
        '{"motor_names": ["a"], "start_pos": [1], "calib_mode": []}',
        "mid-2025",
    ),
}


@pytest.mark.parametrize(("text", "found"), SPOILED.values(), ids=SPOILED)
def test_a_spoiled_file_is_one_clear_error(tmp_path, text, found):
    path = tmp_path / "black.json"
    path.write_text(text)
    with pytest.raises(FileFormatError) as caught:
        read_lerobot(path)
    assert found in caught.value.message
    assert caught.value.message.isprintable()


@pytest.mark.parametrize("count", [400, pytest.param(100_000, marks=CAMPAIGN)])
def test_mutated_files_are_read_or_refused_but_never_trip_the_reader(tmp_path, count):
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


def test_a_second_servo_and_what_a_touch_off_found_are_said_to_be_left_out(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    arm = hidden_arm("vx300s", 3, spoiled=False)
    with arm.loose() as loose:
        calibration = plain_calibration(arm, loose, datetime(2026, 11, 2, tzinfo=UTC))
    said = "\n".join(unsaid(calibration.model_copy(update={"geometry": GEOMETRY})))
    assert "Servo 3 of shoulder is not in it" in said
    assert "that a touch-off found are not in it" in said
