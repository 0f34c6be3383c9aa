"""``ikservo identify``, ``sim --as-identified`` and ``gripper --weigh``."""

import json
import signal
from contextlib import contextmanager

import numpy as np
import pytest

import ikservo
import servosim
from ikservo.apps.lab.arm_identification import QUICK_TOUR, IdentificationRun
from ikservo.apps.lab.identify_command import record_tour
from ikservo.calibration.identified_file import load_identified, read_identified, save_identified
from ikservo.calibration.paths import identified_path
from ikservo.cli.commands import sim
from ikservo.errors import (
    CalibrationError,
    FileFormatError,
    InputError,
    RefusedError,
    StoppedError,
)
from ikservo.model import find_arm, load_model
from ikservo.model.identified_drives import identified_parameters
from ikservo.model.joint_drive import nominal_parameters
from ikservo.planning.reports import MotionProgress
from tests.arm.simulated import servo_group
from tests.cli.fixtures_mounted_arm import PORT, connect_arm
from tests.cli.fixtures_ports import run_arguments

pytestmark = pytest.mark.full  # most need an identified arm, which takes six seconds

ARM = "open_manipulator_x"
MODEL = load_model(ARM)


@pytest.fixture(scope="module")
def identified(tmp_path_factory):
    """Return the output of the command for an arm with hidden masses, and its user folder."""
    home = tmp_path_factory.mktemp("home")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("IKSERVO_HOME", str(home))
        words = ["identify", "--arm", ARM, "--port", "sim:?mass_scale=1.2", "--quick"]
        result = run_arguments([*words, "--json"])
    return result, home


@pytest.fixture
def home(identified, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(identified[1]))
    return identified[1]


@pytest.mark.full
def test_identify_reports_and_saves_parameters(identified, home):
    result = identified[0]
    assert result.code == 0, result.err
    assert "slow motions" in result.err
    answer = json.loads(result.out)
    lift = next(joint for joint in answer["joints"] if joint["name"] == "joint2")
    assert lift["mass_scale"]["value"] == pytest.approx(1.2, rel=0.1)
    assert lift["stiffness_nm_rad"]["determined"]
    assert read_identified(home / "identified" / answer["path"].split("/")[-1]).arm == ARM


@pytest.mark.full
def test_arm_parameters_are_read_from_identification_file(home):
    found = load_identified(ARM, "sim")
    own = identified_parameters(MODEL, MODEL.chain, found)
    usual = nominal_parameters(MODEL, MODEL.chain)
    q = MODEL.chain_pose("home")
    ratio = own.dynamics.gravity_torques(q)[2] / usual.dynamics.gravity_torques(q)[2]
    assert ratio == pytest.approx(1.2, rel=0.05)
    joint = found.joint("joint2")
    assert own.drives[1].stiffness_nm_rad == pytest.approx(joint.stiffness_nm_rad)
    assert own.drives[1].friction.coulomb_nm == pytest.approx(joint.coulomb_nm)


@pytest.mark.full
def test_opened_arm_uses_its_identified_parameters(home):
    joint = load_identified(ARM, "sim").joint("joint2")
    with ikservo.open_arm(ARM, port="sim") as arm:
        own = servo_group(arm).compensator.feed_forward.parameters
    assert own.drives[1].stiffness_nm_rad == pytest.approx(joint.stiffness_nm_rad)


def test_simulator_uses_identified_masses_and_motors(home, monkeypatch):
    seen = []
    monkeypatch.setattr(sim, "_load_server", lambda: lambda args: seen.append(args) or 0)
    assert run_arguments(["sim", ARM, "--as-identified"]).code == 0
    (words,) = seen
    port = servosim.open_port(f"sim:{find_arm(ARM).resolve()}?parameters={words[-1]}")
    joint = load_identified(ARM, "sim").joint("joint2")
    motor = port.line.world.joint("joint2").servos[0].motor.parameters
    assert words[-2] == "--parameters"
    assert motor.duty_torque_nm == pytest.approx(joint.full_duty_nm)
    assert motor.friction_nm == pytest.approx(joint.coulomb_nm)


@pytest.mark.campaign
def test_gripper_weigh_option_estimates_payload(home):
    words = ["gripper", "--weigh", "--arm", ARM, "--json"]
    result = run_arguments([*words, "--port", "sim:?mass_scale=1.2&payload_g=80"])
    answer = json.loads(result.out)
    assert answer["identified"]
    assert answer["payload_kg"] == pytest.approx(0.08, abs=0.01)


def test_sim_as_identified_option_needs_identified_arm(monkeypatch, tmp_path):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    result = run_arguments(["sim", "koch", "--as-identified"])
    assert result.code == InputError("").exit_code
    assert "ikservo identify --arm koch" in result.err


@pytest.mark.parametrize("words", [["gripper"], ["gripper", "open", "--weigh"]])
def test_gripper_command_needs_either_target_or_weigh_option(words):
    assert run_arguments([*words, "--arm", ARM, "--port", "sim"]).code == 2


def test_damaged_identification_file_is_refused(home):
    path = identified_path(ARM, "sim")
    before = path.read_text()
    try:
        path.write_text(before.replace("mass_scale", "mass_scala", 1))
        with pytest.raises(FileFormatError):
            load_identified(ARM, "sim")
    finally:
        path.write_text(before)


def test_identified_file_round_trips(home):
    found = load_identified(ARM, "sim")
    assert read_identified(save_identified(found)) == found


def files_in(folder):
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.mark.full
def test_ctrl_c_stops_identify_and_keeps_file(home, monkeypatch):
    record, before = IdentificationRun.record, files_in(home / "identified")

    def interrupted(run, _):
        cycles = iter(range(10**6))

        def interrupt(_):
            if next(cycles) == 100:
                signal.raise_signal(signal.SIGINT)

        return record(run, interrupt)

    monkeypatch.setattr(IdentificationRun, "record", interrupted)
    result = run_arguments(["identify", "--arm", ARM, "--port", "sim", "--quick"])
    assert result.code == StoppedError("").exit_code
    assert result.out == ""
    assert "Ctrl-C" in result.err
    assert files_in(home / "identified") == before


def test_identify_refuses_uncalibrated_arm_without_moving(monkeypatch, tmp_path):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    arm = connect_arm(monkeypatch, "so101")
    result = run_arguments(["identify", "--arm", "so101", "--port", PORT, "--yes"])
    assert result.code == CalibrationError("").exit_code
    assert "calibrate" in result.err
    assert not any(arm.register(i, "torque_enable") for i in range(1, 7))
    assert not (tmp_path / "identified").exists()


def test_identify_refuses_arm_without_masses(home, monkeypatch):
    monkeypatch.setattr("ikservo.apps.lab.arm_identification.link_masses", lambda *_: [])
    result = run_arguments(["identify", "--arm", ARM, "--port", "sim"])
    assert result.code == RefusedError("").exit_code
    assert "has no masses in its URDF" in result.err


def test_identify_reports_unwritable_folder_before_motion(monkeypatch, tmp_path):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    (tmp_path / "identified").write_text("a file, not a folder")
    monkeypatch.setattr(IdentificationRun, "go_to_start", lambda *_: pytest.fail("it moved"))
    result = run_arguments(["identify", "--arm", ARM, "--port", "sim", "--quick"])
    assert result.code == 1
    assert "Traceback" not in result.err
    assert "identified" in result.err


def test_where_command_refuses_damaged_identification_file(home):
    path = identified_path(ARM, "sim")
    before = path.read_text()
    try:
        path.write_text(before[:-20])
        result = run_arguments(["where", "--arm", ARM, "--port", "sim"])
        assert result.code == FileFormatError(path, "", "").exit_code
        assert str(path) in result.err
    finally:
        path.write_text(before)


def test_identification_shows_motion_count_and_time_left(monkeypatch):
    shown = []
    bar = contextmanager(lambda: iter([lambda *given: shown.append(given)]))
    monkeypatch.setattr("ikservo.apps.lab.identify_command.progress_bar", bar)

    def pass_time(run, on_progress):
        for time_s in (0.0, run.duration_s):
            on_progress(MotionProgress(time_s, run.duration_s, np.zeros(3)))

    monkeypatch.setattr(IdentificationRun, "record", pass_time)
    with ikservo.open_arm("planar2", port="sim") as arm:
        run = IdentificationRun.plan(arm, QUICK_TOUR)
        record_tour(run)
    count, total_s = len(run.excitation.legs), run.duration_s
    assert shown == [
        (f"motion 1 of {count}", 0.0, total_s),
        (f"motion {count} of {count}", total_s, total_s),
    ]
