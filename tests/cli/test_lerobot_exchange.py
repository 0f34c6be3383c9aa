"""``ikservo import lerobot`` and ``ikservo export lerobot``, in both directions."""

import json
import math

import pytest

from ikservo.calibration.calibration_file import read_calibration
from tests.calibration.lerobot_files import lerobot_text
from tests.calibration.mounted_arms import load_model, make_mounted_arm
from tests.calibration.scripted_operator import schedule_operator

PORT = "/dev/ttyBENCH"


@pytest.fixture
def arm(monkeypatch, tmp_path):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))
    arm = make_mounted_arm("so101", 21, spoiled=False)

    def open_transport(port, baud_rate):
        arm.port.is_open = True
        return arm.port

    monkeypatch.setattr("ikservo.hardware.port.open_transport", open_transport)
    return arm


def imported(arm, run_cli, path):
    with arm.open_limp() as limp_arm:
        schedule_operator(arm, limp_arm.make_subjects("home"))
    words = f"import lerobot {path} --arm so101 --port {PORT} --pose home --margin 0.3 --yes"
    done = run_cli(words)
    arm.world.hands.clear()
    return done


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize("kind", ["so_follower", "so100_follower", "so101_follower"])
def test_lerobot_file_survives_import_and_export_byte_for_byte(
    arm, run_cli, tmp_path, monkeypatch, kind
):
    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", str(tmp_path / "lerobot"))
    path = tmp_path / "lerobot" / "robots" / kind / "black.json"
    path.parent.mkdir(parents=True)
    path.write_text(lerobot_text(arm))
    writes = arm.eeprom_writes()
    done = imported(arm, run_cli, "black")
    assert done.code == 0, done.err
    assert arm.eeprom_writes() == writes
    back = run_cli("export lerobot --arm so101")
    assert back.out.encode() == path.read_bytes()


@pytest.mark.full
def test_lerobot_import_keeps_swept_range_and_true_zero(arm, run_cli, tmp_path):
    path = tmp_path / "black.json"
    path.write_text(lerobot_text(arm))
    assert imported(arm, run_cli, path).code == 0
    calibration = read_calibration(tmp_path / "home" / "arms" / "so101.toml")
    for joint in load_model("so101").joints:
        own = calibration.joint(joint.name)
        servo = arm.line.servos[joint.servo.id]
        truth = own.joint_map(joint.joint_map).position(servo.read("present_position"))
        assert truth == pytest.approx(arm.true_position(joint.name), abs=math.radians(0.3))
        if own.swept == "by LeRobot":
            assert own.recorded_range()[0] >= arm.stops[joint.name][0] - 0.002
    assert calibration.source(calibration.joint("elbow_flex")).startswith("LeRobot's sweep of")


@pytest.mark.full
def test_lerobot_export_reports_values_it_cannot_contain(arm, run_cli, tmp_path):
    path = tmp_path / "black.json"
    path.write_text(lerobot_text(arm))
    imported(arm, run_cli, path)
    result = run_cli("export lerobot --arm so101").err
    assert "middle of each range as zero" in result
    assert "wrist_roll was not swept; LeRobot's file gets a full turn." in result


@pytest.mark.full
def test_lerobot_export_with_to_option_writes_file(arm, run_cli, tmp_path):
    path = tmp_path / "black.json"
    path.write_text(lerobot_text(arm))
    imported(arm, run_cli, path)
    run_cli(f"export lerobot --arm so101 --to {tmp_path / 'again.json'}")
    assert (tmp_path / "again.json").read_bytes() == path.read_bytes()


def test_lerobot_import_refuses_ids_of_another_arm(arm, run_cli, tmp_path):
    table = json.loads(lerobot_text(arm))
    table["elbow_flex"]["id"] = 30
    path = tmp_path / "black.json"
    path.write_text(json.dumps(table))
    done = run_cli(f"import lerobot {path} --arm so101 --port {PORT} --yes")
    assert done.code == 6
    assert "elbow_flex has id 30 in LeRobot's file and 3 in the arm file" in done.err


def test_lerobot_import_names_a_missing_joint(arm, run_cli, tmp_path):
    table = json.loads(lerobot_text(arm))
    del table["wrist_flex"]
    path = tmp_path / "black.json"
    path.write_text(json.dumps(table))
    done = run_cli(f"import lerobot {path} --arm so101 --port {PORT} --yes")
    assert done.code == 6
    assert "has no joint 'wrist_flex'" in done.err


@pytest.mark.full
def test_lerobot_import_restores_a_lost_homing_offset(arm, run_cli, tmp_path):
    path = tmp_path / "black.json"
    path.write_text(lerobot_text(arm))
    recorded = json.loads(path.read_text())["elbow_flex"]["homing_offset"]
    arm.line.servos[3].write("lock", 0)
    arm.line.servos[3].write("homing_offset", 0)
    done = imported(arm, run_cli, path)
    assert done.code == 0, done.err
    assert f"elbow_flex holds homing_offset 0; LeRobot recorded {recorded}" in done.err
    assert arm.register(3, "homing_offset") == recorded


def test_lerobot_export_without_calibration_exits_6(arm, run_cli):
    done = run_cli("export lerobot --arm so101")
    assert (done.code, done.out) == (6, "")


def test_export_to_unknown_program_lists_known_programs(arm, run_cli):
    done = run_cli("export dynamixel_wizard --arm so101")
    assert done.code == 2
    assert "Known: csv, dataset, lerobot" in done.err
