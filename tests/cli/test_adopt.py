"""An arm on another adapter keeps its calibration if the user confirms it."""

import pytest

from ikservo.calibration.calibration_file import read_calibration
from ikservo.calibration.paths import calibration_path
from tests.cli.fixtures_mounted_arm import PORT, connect_arm, write_calibration

NAME, OLD, NEW = "planar2", "58FA083", "9C0FFEE"
WORDS = f"calibration adopt {NAME} --port {PORT}"


@pytest.fixture(autouse=True)
def _home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))


@pytest.fixture
def arm(monkeypatch):
    """Return an arm that was calibrated on an old adapter and is now on a new one."""
    arm = connect_arm(monkeypatch, NAME, serial=NEW, spoiled=False)
    write_calibration(arm, serial="")
    calibration = read_calibration(calibration_path(NAME, ""))
    move(calibration, OLD)
    calibration_path(NAME, "").unlink()
    return arm


def move(calibration, serial):
    from ikservo.calibration.calibration_file import save_calibration

    return save_calibration(calibration.model_copy(update={"usb_serial_number": serial}))


def test_adopted_calibration_applies_on_the_new_adapter(arm, run_cli):
    assert run_cli(f"calibration diff {NAME} --port {PORT}").code == 6
    done = run_cli(f"{WORDS} --yes")
    assert done.code == 0, done.err
    assert f"(adapter {OLD})" in done.err
    adopted = read_calibration(calibration_path(NAME, NEW))
    assert adopted.usb_serial_number == NEW
    assert run_cli(f"calibration diff {NAME} --port {PORT}").code == 0


def test_missing_calibration_error_suggests_calibration_adopt(arm, run_cli):
    done = run_cli(f"calibration diff {NAME} --port {PORT}")
    assert f"ikservo calibration adopt {NAME}" in done.err


def test_calibration_adopt_does_nothing_without_confirmation(arm, run_cli):
    assert run_cli(WORDS).code == 1
    assert not calibration_path(NAME, NEW).exists()


def test_calibration_adopt_refuses_servos_with_other_registers(arm, run_cli):
    arm.line.servos[2].write("lock", 0)
    arm.line.servos[2].write("homing_offset", 77)
    done = run_cli(f"{WORDS} --yes")
    assert done.code == 6
    assert "homing_offset of joint2 (id 2) is 77 in the servo" in done.err
    assert not calibration_path(NAME, NEW).exists()


def test_calibration_adopt_needs_file_argument_if_several_fit(arm, run_cli):
    calibration = read_calibration(calibration_path(NAME, OLD))
    other = move(calibration, "ANOTHER")
    assert run_cli(f"{WORDS} --yes").code == 6
    assert run_cli(f"{WORDS} --yes --from {other}").code == 0


def test_calibration_adopt_refuses_calibration_of_another_arm(arm, run_cli):
    calibration = read_calibration(calibration_path(NAME, OLD))
    other = move(calibration.model_copy(update={"arm": "planar3"}), OLD)
    done = run_cli(f"{WORDS} --yes --from {other}")
    assert (done.code, "made for planar2" in done.err, "made for planar3" in done.err) == (
        6, False, True)  # fmt: skip


def test_calibration_push_refuses_the_from_option(arm, run_cli):
    assert run_cli(f"calibration push {NAME} --port {PORT} --from x").code == 2


@pytest.fixture
def recording(arm, run_cli, tmp_path):
    """Return a recording of the arm, and its calibration, which is then deleted."""
    assert run_cli(f"{WORDS} --yes").code == 0
    path, own = tmp_path / "wave.mcap", calibration_path(NAME, NEW)
    done = run_cli(f"record {path} --arm {NAME} --port {PORT} --duration 0.1")
    assert done.code == 0, done.err
    calibration = read_calibration(own)
    own.unlink()
    calibration_path(NAME, OLD).unlink()
    return path, calibration


def import_recording(path):
    return f"import recording {path} --arm {NAME} --port {PORT} --yes --json"


def test_import_recording_restores_its_calibration(recording, run_cli):
    path, calibration = recording
    done = run_cli(import_recording(path))
    assert done.code == 0, done.err
    assert read_calibration(calibration_path(NAME, NEW)) == calibration
    assert run_cli(f"calibration diff {NAME} --port {PORT}").code == 0


def test_import_recording_refuses_other_servos(arm, recording, run_cli):
    arm.line.servos[2].write("lock", 0)
    arm.line.servos[2].write("homing_offset", 77)
    done = run_cli(import_recording(recording[0]))
    assert (done.code, "homing_offset of joint2" in done.err) == (6, True)
    assert not calibration_path(NAME, NEW).exists()


def test_import_recording_without_calibration_is_refused(arm, run_cli, tmp_path):
    path = tmp_path / "sim.mcap"
    assert run_cli(f"record {path} --arm {NAME} --port sim --duration 0.1").code == 0
    done = run_cli(import_recording(path))
    assert (done.code, "No calibration is attached" in done.err) == (6, True)
    path.write_text("{}")
    assert run_cli(import_recording(path)).code == 2
