"""A damaged calibration is detected, and each command names the possible remedies."""

import os

import pytest

from ikservo.calibration.calibration_file import (
    backup_path,
    read_calibration,
    save_calibration,
)
from ikservo.calibration.paths import calibration_path
from tests.cli.fixtures_mounted_arm import PORT, SERIAL, connect_arm, write_calibration

NAME = "planar2"
AT = f"--arm {NAME} --port {PORT}"


@pytest.fixture
def arm(monkeypatch, tmp_path):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))
    return connect_arm(monkeypatch, NAME, spoiled=False)


@pytest.fixture
def path(arm):
    """Return the damaged calibration of the arm, with its predecessor beside it."""
    write_calibration(arm)
    path = calibration_path(NAME, SERIAL)
    save_calibration(read_calibration(path))
    path.write_text(path.read_text().replace("zero_tick = ", "zero_tick = 1"))
    return path


@pytest.mark.parametrize(
    "words", [f"where {AT}", f"pose home {AT}", f"calibration diff {NAME} --port {PORT}"]
)
def test_damaged_calibration_error_lists_three_remedies(words, path, run_cli):
    done = run_cli(words)
    assert done.code != 0
    for way in ("calibration restore planar2", "ikservo calibrate planar2", "ikservo relax"):
        assert way in " ".join(done.err.split())


def test_restore_uses_backup_and_keeps_damaged_calibration(path, run_cli):
    assert run_cli(f"calibration restore {NAME}").code == 0
    assert read_calibration(path).arm == NAME
    assert path.with_name(f"{path.name}.damaged").exists()
    assert run_cli(f"where {AT}").code == 0


@pytest.mark.parametrize("damage", [b"", b"\xff\x00", None], ids=["empty", "binary", "changed"])
def test_calibration_over_damaged_file_keeps_valid_backup(damage, arm, path):
    backup = backup_path(path)
    sound = backup.read_bytes()
    if damage is not None:
        path.write_bytes(damage)
    write_calibration(arm)
    assert read_calibration(path).arm == NAME
    assert backup.read_bytes() == sound
    assert path.with_name(f"{path.name}.damaged").exists()


def test_restore_refuses_pipe_in_place_of_calibration_at_once(path, run_cli):
    path.unlink()
    os.mkfifo(path)
    done = run_cli(f"calibration restore {NAME} --port {PORT}")
    assert done.code == 2
    assert "is not a regular file" in done.err


def test_restore_refuses_to_replace_valid_calibration(path, run_cli):
    run_cli(f"calibration restore {NAME}")
    assert run_cli(f"calibration restore {NAME} --port {PORT}").code == 2


def test_calibration_show_prints_zeros_ranges_and_adapter(path, run_cli):
    run_cli(f"calibration restore {NAME}")
    out = run_cli(f"calibration show {NAME}").out
    for word in (SERIAL, "2026-11-02", "joint1", "tick ", "STS3215 (id 1)", "the joint"):
        assert word in out


def test_doctor_reports_damaged_calibration(path, run_cli):
    done = run_cli(f"doctor {AT}")
    assert "✗ zeros" in done.out
    assert "calibration restore" in done.out


def test_relax_with_damaged_calibration_asks_before_torque_off(arm, path, run_cli):
    servos = arm.line.servos.values()
    for servo in servos:
        servo.write("torque_enable", 1)
    asked = run_cli(f"relax {AT}")
    assert asked.code == 1
    assert all(servo.read("torque_enable") for servo in servos)
    assert run_cli(f"relax {AT} --yes").code == 0
    assert not any(servo.read("torque_enable") for servo in servos)
