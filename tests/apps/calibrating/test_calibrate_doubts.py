"""Results that contradict the arm file are questioned, not saved silently."""

import math
from contextlib import nullcontext

import pytest

from ikservo.apps.calibrating.by_hand_dialogue import check_zeros
from ikservo.apps.calibrating.by_hand_procedure import CalibrationStage, CalibrationState
from ikservo.apps.calibrating.calibration_session import TorqueOffArm
from ikservo.apps.calibrating.range_tracker import RangeTracker
from ikservo.calibration import JointMap, Limits
from ikservo.calibration.calibration_file import read_calibration
from ikservo.calibration.paths import calibration_path
from ikservo.calibration.uncalibrated_joint import JointUnderCalibration
from ikservo.cli.terminal_dialogue import Operator
from ikservo.cli.wiggle_prompt import check_new_signs
from ikservo.errors import CalibrationError
from ikservo.maintenance.direction_check import directions_confirmed
from tests.calibration.mounted_arms import load_model
from tests.calibration.scripted_operator import schedule_operator
from tests.cli.fixtures_mounted_arm import PORT, SERIAL, connect_arm, write_calibration

NAME = "planar2"
WORDS = f"calibrate {NAME} --port {PORT} --pose home --margin 0.3"


@pytest.fixture(autouse=True)
def _home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))


@pytest.fixture
def mount_arm(monkeypatch):
    """Return a function that mounts an arm that an operator moves by hand."""

    def mounted_arm(moved=(), off_deg=0.0, **how):
        arm = connect_arm(monkeypatch, NAME, spoiled=False, **how)
        for name, position in load_model(NAME).pose("home").items():
            arm.world.place(name, position + math.radians(off_deg))
        with arm.open_bus() as bus:
            subjects = TorqueOffArm(load_model(NAME), bus).make_subjects("home", only=moved)
        schedule_operator(arm, subjects)
        return arm

    return mounted_arm


def saved():
    path = calibration_path(NAME, SERIAL)
    return read_calibration(path) if path.exists() else None


def answering(monkeypatch, **answers):
    """Answer each question by its first word; return the list of questions."""
    asked = []

    def read_answer(prompt):
        asked.append(prompt)
        return answers.get(prompt.split()[0], "y")

    monkeypatch.setattr("ikservo.cli.terminal.read_answer", read_answer)
    return asked


# --- signs ---


def test_joint_signs_equal_to_arm_file_need_no_direction_test(mount_arm, run_cli):
    mount_arm(sign=1)
    done = run_cli(f"{WORDS} --yes")
    assert done.code == 0, done.err
    assert "opposite" not in done.err
    assert directions_confirmed(load_model(NAME), PORT)


def test_opposite_joint_sign_stays_unconfirmed_after_two_trials(mount_arm, run_cli):
    mount_arm(sign=-1)
    done = run_cli(f"{WORDS} --yes")
    assert done.code == 0, done.err
    assert "joint1 turned opposite to the direction in the arm file. Was it first" in done.err
    assert "Move joint1 again so that the tool moves to the right" in done.err
    assert "joint1: its sign, measured twice, contradicts the arm file" in done.err
    assert f"ikservo calibrate {NAME} --wiggle" in done.err
    assert [joint.sign for joint in saved().joints] == [-1, -1]
    assert not directions_confirmed(load_model(NAME), PORT)


def check_with_answers(monkeypatch, **answers):
    """Calibrate an arm with opposite signs; return the questions about the test motion."""
    arm = connect_arm(monkeypatch, NAME, spoiled=False, sign=-1)
    write_calibration(arm)
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    asked = answering(monkeypatch, **answers)
    operator = Operator(None, yes=False, interactive=True)
    return asked, lambda: check_new_signs(load_model(NAME), PORT, ["joint1"], operator)


@pytest.mark.full
def test_direction_test_is_offered_for_doubtful_joint_only(monkeypatch, capsys):
    asked, check = check_with_answers(monkeypatch)
    assert check() is True
    assert [prompt.split()[0] for prompt in asked] == ["Run", "Did"]
    assert "joint1 moves so that the tool moves" in capsys.readouterr().err


def test_direction_test_in_wrong_direction_is_reported(monkeypatch):
    _, check = check_with_answers(monkeypatch, Did="n")
    with pytest.raises(CalibrationError, match="joint1 does not move as"):
        check()


def test_postponed_direction_test_stays_pending(monkeypatch, capsys):
    _, check = check_with_answers(monkeypatch, Run="n")
    assert check() is False
    assert "The first motion begins with this test" in capsys.readouterr().err


# --- zeros ---


@pytest.mark.parametrize("off_deg", [-28.0, 28.0])
def test_wrong_anchor_pose_is_refused_without_terminal(mount_arm, run_cli, off_deg):
    arm = mount_arm(sign=1, off_deg=off_deg)
    before = [servo.memory.eeprom_writes for servo in arm.world.servos]
    done = run_cli(f"{WORDS} --yes")
    assert done.code == 6
    assert "the zero seems to be off by 2" in done.err
    assert 'The arm was not in the pose "home"' in done.err
    assert saved() is None
    assert [servo.memory.eeprom_writes for servo in arm.world.servos] == before


def shifted_state(name="joint1"):
    """Return a conversation at its review whose first joint was swept 28° off."""
    joint_map = JointMap.revolute(name, 1, 1, 2048, 4096)
    subject = JointUnderCalibration(joint_map, 4096, Limits.of(name, -1.0, 1.0, "arm file"), 0.0)
    track = RangeTracker(4096, 0, -652 + 319, 652 + 319, 0.0)
    return CalibrationState(
        (subject,),
        0.0,
        CalibrationStage.REVIEW,
        {1: track},
        reference_ticks={1: 0.0},
        signs={name: 1},
    )


@pytest.mark.parametrize("answer", ["y", "n"])
def test_implausible_zero_needs_confirmation_on_terminal(monkeypatch, capsys, answer):
    asked = answering(monkeypatch, Was=answer)
    refused = nullcontext() if answer == "y" else pytest.raises(CalibrationError, match="pose")
    with refused:
        Operator(None, yes=False, interactive=True).run(check_zeros(shifted_state(), "home", NAME))
    assert asked == ['Was joint1 exactly as in the pose "home" at step 1? [y/n]: ']
    assert "the zero seems to be off by 28.0°" in capsys.readouterr().err


# --- one joint again ---


@pytest.fixture
def calibrated(mount_arm, monkeypatch):
    """Calibrate an arm by hand, with the first joint held in the pose; return the arm."""
    arm = mount_arm(moved=["joint1"], sign=1)
    write_calibration(arm)
    return arm


def test_calibrating_one_joint_keeps_values_of_the_other(calibrated, run_cli):
    before = saved()
    done = run_cli(f"{WORDS} --joint joint1 --yes")
    assert done.code == 0, done.err
    assert 'Step 1 of 4: Put joint1 at 45.0° (pose "home")' in done.err
    after = saved()
    assert after.joint("joint2") == before.joint("joint2")
    assert (
        after.joint("joint1").recorded_range()[0] < before.joint("joint1").recorded_range()[0] - 0.5
    )


def test_calibrating_one_joint_needs_calibration_of_others(mount_arm, run_cli):
    arm = mount_arm(moved=["joint1"], sign=1)
    arm.line.servos[1].write("torque_enable", 1)
    done = run_cli(f"{WORDS} --joint joint1 --yes")
    assert (done.code, "is not calibrated" in done.err) == (6, True)
    assert arm.register(1, "torque_enable") == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--joint joint9 --yes", "joint1, joint2"),
        ("--joint joint1 --touch --yes", "--joint can only be given in a calibration by hand"),
        ("--joint joint1 --auto --yes", "--joint can only be given in a calibration by hand"),
    ],
)
def test_misused_joint_option_of_calibrate_gives_one_error(calibrated, run_cli, words, message):
    done = run_cli(f"{WORDS} {words}")
    assert (done.code, message in done.err) == (2, True), done.err


# --- Ctrl-C ---


@pytest.mark.parametrize("at_s", [0.3, 1.5, 4.0])
def test_ctrl_c_in_calibrate_says_that_nothing_was_saved(mount_arm, run_cli, monkeypatch, at_s):
    arm = mount_arm(sign=1)
    arm.line.servos[1].write("torque_enable", 1)
    read = TorqueOffArm.read_ticks

    def interrupted(limp_arm):
        if limp_arm.bus.clock.now_s() > at_s:
            raise KeyboardInterrupt
        return read(limp_arm)

    monkeypatch.setattr(TorqueOffArm, "read_ticks", interrupted)
    done = run_cli(f"{WORDS} --yes")
    assert (done.code, done.err.splitlines()[-1]) == (
        130, "Stopped: nothing was saved; torque is off.")  # fmt: skip
    assert saved() is None
    assert arm.register(1, "torque_enable") == 0
