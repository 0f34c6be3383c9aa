"""A calibration file is accepted completely or not at all."""

import math
import random
from datetime import UTC, datetime

import pytest

from ikservo.calibration import Limits
from ikservo.calibration.calibration_file import (
    dump_calibration,
    load_calibration,
    parse_calibration,
    read_calibration,
    save_calibration,
)
from ikservo.calibration.paths import calibration_path, calibrations_of, partial_path
from ikservo.calibration.records import CalibratedGeometry, CalibratedOrigin, Calibration
from ikservo.errors import CalibrationError, FileFormatError, IkservoError
from ikservo.files.writing import with_checksum
from tests.calibration.factories import make_calibration
from tests.calibration.mounted_arms import make_mounted_arm

CAMPAIGN = (pytest.mark.campaign, pytest.mark.timeout(1200))
GEOMETRY = CalibratedGeometry(
    touched=datetime(2026, 11, 3, 9, 0, 0, tzinfo=UTC),
    touches=15,
    left_out=1,
    before_mm=14.7,
    after_mm=1.2,
    base_moved_mm=(1.5, -2.0, 0.25),
    base_turned_deg=(0.1, 0.0, -0.5),
    origins=(CalibratedOrigin(joint="joint2", moved_mm=(0.5, -1.0, 0.75)),),
)
WHEN = datetime(2026, 11, 2, 14, 3, 22, tzinfo=UTC)


@pytest.fixture(autouse=True)
def _home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))


@pytest.fixture(scope="module")
def calibration():
    arm = make_mounted_arm("open_manipulator_x", 5)
    with arm.open_limp() as limp_arm:
        found = make_calibration(arm, limp_arm, WHEN)
    return found.model_copy(update={"geometry": GEOMETRY})


@pytest.fixture
def path(calibration):
    return save_calibration(calibration)


def body_of(calibration):
    return dump_calibration(calibration).partition("\n")[2]


def refusal(path, text):
    path.write_text(text)
    with pytest.raises(FileFormatError) as caught:
        read_calibration(path)
    return caught.value


def test_calibration_file_survives_write_and_read(calibration, path):
    assert read_calibration(path) == calibration


def test_calibration_file_has_units_date_and_serial_number(path):
    text = path.read_text()
    keys = ("format = 1", "written = 2026-11-02 14:03:22+00:00", "tool_version", "firmware",
            "usb_serial_number", "margin_deg", "lower_deg", "lower_m", "travel_ticks")  # fmt: skip
    for key in keys:
        assert key in text


def test_calibration_file_omits_empty_values(path):
    text = path.read_text()
    assert "[]" not in text
    assert "shadows" not in text


def test_calibration_file_without_geometry_is_still_read(calibration, path):
    older = calibration.model_copy(update={"geometry": None})
    path.write_text(dump_calibration(older))
    assert "geometry" not in path.read_text()
    assert read_calibration(path) == older


def test_calibration_file_with_windows_line_ends_is_read(calibration, path):
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    assert read_calibration(path) == calibration


def test_calibration_file_cut_at_any_length_is_refused(path):
    text = path.read_text()
    for length in range(0, len(text) - 1, 37):
        assert refusal(path, text[:length]).found in (
            "is damaged: its checksum does not match its content", "is empty", "is not a checksum",
        )  # fmt: skip


def test_calibration_with_edited_limit_is_refused_naming_backup(path):
    text = path.read_text()
    assert ".bak" not in refusal(path, text[:-9]).expected
    path.with_name(f"{path.name}.bak").write_text(text)
    old = next(line for line in text.splitlines() if line.startswith("lower_deg"))
    error = refusal(path, text.replace(old, "lower_deg = -170.0"))
    assert "checksum does not match" in error.found
    assert ".bak" in error.expected


def test_foreign_json_file_is_refused_as_calibration(path):
    assert refusal(path, '{"shoulder_pan": {"id": 1}}').found == "is not a checksum"


def test_future_calibration_format_asks_for_a_newer_ikservo(calibration, path):
    body = body_of(calibration).replace("format = 1", "format = 2")
    error = refusal(path, with_checksum(body))
    assert (error.where, error.found) == ("format", "is 2")
    assert "update ikservo" in error.expected


# Where the checksum is right, the values are looked at all the same.
SLIPS = {
    "unknown key": ("tool_version", "tool_versoin", "tool_versoin"),
    "no number": ("zero_tick = ", "zero_tick = nan # ", "joints[0].zero_tick"),
    "sign of two": ("sign = ", "sign = 2 # ", "joints[0].sign"),
    "id of a letter": ("id = 11", 'id = "11"', "joints[0].servo.id"),
    "id out of range": ("id = 11", "id = 300", "joints[0].servo.id"),
    "two of one id": ("id = 12", "id = 11", "joints[1].servo.id"),
    "two of one name": ('"joint2"', '"joint1"', "joints[1].name"),
    "unknown model": ('"XM430-W350"', '"XM999"', "joints[0].servo.model"),
    "unknown register": ("homing_offset", "homing_ofset", "joints[0].servo.holds.homing_ofset"),
    "a register left out": ("homing_offset = ", "# homing_offset = ", "holds.homing_offset"),
    "no register value": ("operating_mode = ", "operating_mode = 99 # ", ""),
    "swept by nobody": ('swept = "by hand"', 'swept = "by foot"', "joints[0].swept"),
    "swept without limits": ('swept = "by hand"', 'swept = "not swept"', "joints[0].swept"),
    "no offset of time": ("14:03:22+00:00", "14:03:22", "written"),
    "a base that is elsewhere": ("base_moved_mm = [", "base_moved_mm = [51.0,", "geometry.base_"),
    "an origin without a number": ("moved_mm = [", "moved_mm = [nan,", "geometry."),
    "a touch at no time": ("touches = 15", "touches = 0", "geometry.touches"),
    "a touch without an offset": ("09:00:00+00:00", "09:00:00", "geometry.touched"),
    "an unknown correction": ("left_out", "leftout", "geometry.leftout"),
    "huge margin": ("margin_deg = ", "margin_deg = 90 # ", "margin_deg"),
}


@pytest.mark.parametrize(("old", "new", "where"), SLIPS.values(), ids=SLIPS)
def test_calibration_file_error_names_its_key(calibration, path, old, new, where):
    body = body_of(calibration)
    assert old in body
    error = refusal(path, with_checksum(body.replace(old, new, 1)))
    assert where in error.where


@pytest.mark.parametrize("travel", [(5, 5), (900, 100), (0, 4096), (10, 30), (-5, 2000)])
def test_impossible_travel_in_calibration_is_refused(calibration, path, travel):
    joint = calibration.joints[0].model_copy(update={"travel_ticks": travel, "extended": False})
    joints = (joint, *calibration.joints[1:])
    spoiled = calibration.model_copy(update={"joints": joints})
    assert refusal(path, dump_calibration(spoiled)).where == "joints[0].travel_ticks"


def test_sts_homing_offset_beyond_its_register_is_refused(path):
    arm = make_mounted_arm("planar2", 5, spoiled=False)
    with arm.open_limp() as limp_arm:
        text = dump_calibration(make_calibration(arm, limp_arm, WHEN))
    line = next(line for line in text.splitlines() if line.startswith("homing_offset"))
    body = text.partition("\n")[2].replace(line, "homing_offset = 2114", 1)
    assert "homing_offset" in refusal(path, with_checksum(body)).where


def mutated(text, chance):
    """Return a text with a few bytes changed, swapped, doubled, removed or inserted."""
    data = bytearray(text.encode())
    for _ in range(chance.randint(1, 4)):
        at = chance.randrange(len(data))
        match chance.randrange(5):
            case 0:
                data[at] = chance.randrange(256)
            case 1:
                del data[at : at + chance.randint(1, 40)]
            case 2:
                data[at:at] = data[at : at + chance.randint(1, 40)]
            case 3:
                data[at] ^= 1 << chance.randrange(8)
            case 4:
                other = chance.randrange(len(data))
                data[at], data[other] = data[other], data[at]
        if not data:
            return b"\n"
    return bytes(data)


def accepts(path, data):
    """Return the parsed file, or None if it is refused; any error but ours fails the test."""
    path.write_bytes(data)
    try:
        return read_calibration(path)
    except IkservoError:
        return None


@pytest.mark.parametrize("count", [600, pytest.param(100_000, marks=CAMPAIGN)])
def test_mutated_calibration_file_is_refused_or_unchanged(calibration, path, count):
    chance, text = random.Random(13), dump_calibration(calibration)
    taken = [accepts(path, mutated(text, chance)) for _ in range(count)]
    assert all(found in (None, calibration) for found in taken)
    assert taken.count(None) > 0.9 * count


@pytest.mark.parametrize("count", [300, pytest.param(100_000, marks=CAMPAIGN)])
def test_mutated_calibration_with_right_checksum_is_validated(calibration, path, count):
    chance, body = random.Random(14), body_of(calibration)
    for _ in range(count):
        spoiled = mutated(body, chance).decode("utf-8", "replace").replace("\r", "")
        found = accepts(path, with_checksum(spoiled).encode())
        for joint in found.joints if found else ():
            low, high = joint.travel_ticks
            assert 50 <= high - low < 4096
            swept = joint.recorded_range()
            assert swept is None or swept[0] < swept[1]
            assert math.isfinite(joint.zero_tick)
        for origin in found.geometry.origins if found and found.geometry else ():
            assert all(abs(move) <= 50.0 for move in origin.moved_mm)


def test_narrower_of_swept_and_user_limit_applies_with_source(calibration):
    joint = calibration.joints[0].model_copy(
        update={"lower_deg": -60.0, "upper_deg": 70.0, "user_upper_deg": 30.0}
    )
    limits = calibration.narrow_limits(joint, Limits.of("joint1", -3.0, 3.0, "arm file"))
    assert (limits.lower.source, limits.upper.source) == ("hand sweep of 2026-11-02", "user")
    assert math.degrees(limits.lower.value) == pytest.approx(-60.0)


def test_error_of_sweep_outside_arm_file_limits_names_both(calibration):
    joint = calibration.joints[0].model_copy(update={"lower_deg": 80.0, "upper_deg": 90.0})
    with pytest.raises(CalibrationError, match=r"80.0° \(hand sweep of 2026-11-02\).*arm file"):
        calibration.narrow_limits(joint, Limits.of("joint1", -1.0, 1.0, "arm file"))


@pytest.mark.parametrize(("serial", "name"), [
    ("58FA083", "so101-58FA083.toml"), ("", "so101.toml"), ("../../etc/x", "so101-etc_x.toml"),
    ("A" * 300, f"so101-{'A' * 64}.toml"), ("\0", "so101.toml"), ("C:\\x", "so101-C_x.toml"),
])  # fmt: skip
def test_calibration_path_of_any_serial_number_stays_in_folder(serial, name, tmp_path):
    assert calibration_path("so101", serial) == tmp_path / "arms" / name


def test_calibration_path_of_any_arm_name_stays_in_folder(tmp_path):
    assert calibration_path("../../so101", "").parent == tmp_path / "arms"


def test_calibrations_of_other_arms_are_not_listed(calibration, path, tmp_path):
    (tmp_path / "arms" / "open_manipulator_x2.toml").write_text("")
    assert calibrations_of("open_manipulator_x") == [path]


def test_interrupted_calibration_is_not_listed_as_calibration(tmp_path):
    unfinished = partial_path("so101", "58FA")
    assert unfinished == tmp_path / "partial" / "so101-58FA.toml"
    unfinished.parent.mkdir(parents=True)
    unfinished.write_text("")
    assert calibrations_of("so101") == []


def test_saved_calibration_is_loaded_for_its_adapter_only(calibration, path):
    assert load_calibration(calibration.arm, calibration.usb_serial_number) == calibration
    assert load_calibration(calibration.arm, "another") is None


def test_loading_missing_calibration_returns_none():
    assert load_calibration("so101", "58FA") is None


def test_previous_calibration_is_kept_as_backup(calibration, path):
    before = path.read_text()
    save_calibration(calibration.model_copy(update={"tool_version": "9.9"}))
    assert path.with_name(f"{path.name}.bak").read_text() == before


def test_calibration_text_is_parsed_to_same_calibration(calibration, path):
    assert isinstance(parse_calibration(path, dump_calibration(calibration)), Calibration)
