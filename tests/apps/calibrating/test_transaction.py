"""After a power cut before any write, the next start finds the old or the new calibration."""

import os
import random
import stat
from datetime import UTC, datetime

import pytest

from ikservo.apps.calibrating.calibration_result import CalibrationResult
from ikservo.apps.calibrating.calibration_session import TorqueOffArm
from ikservo.calibration.calibration_file import dump_calibration, read_calibration
from ikservo.calibration.paths import calibration_path, journal_path
from ikservo.calibration.servo_config import read_servo_config
from ikservo.calibration.transaction import (
    EepromChange,
    Journal,
    dump_journal,
    read_journal,
    recover,
    resume,
    roll_back,
)
from ikservo.errors import CalibrationError, ExitCode, FileFormatError, PortLostError
from ikservo.files.writing import FileWriteError, write_atomic
from ikservo.planning.calibrated_arm import load_calibration_for
from tests.calibration.factories import make_calibration
from tests.calibration.mounted_arms import load_model, make_mounted_arm
from tests.files.power_cuts import PowerCut, PowerSupply, is_write, restore_calls

WHEN = datetime(2026, 11, 2, 14, 3, 22, tzinfo=UTC)


@pytest.fixture(autouse=True)
def _home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))


def arm_and_outcome(name):
    """Return an arm as delivered and a calibration that changes each of its servos."""
    arm = make_mounted_arm(name, 3, spoiled=False)
    with arm.open_limp() as limp_arm:
        calibration = make_calibration(arm, limp_arm, WHEN)
    memory = {servo.id: servo.holds for joint in calibration.joints for servo in joint.servos}
    return arm, CalibrationResult(calibration, memory)


def as_delivered(arm, calibration):
    """Return a calibration that is based on the present registers of the servos."""
    joints = []
    with arm.open_bus() as bus:
        for joint in calibration.joints:
            servo = joint.servo.model_copy(
                update={"holds": read_servo_config(bus, joint.servo.id).registers}
            )
            joints.append(joint.model_copy(update={"servo": servo}))
    return calibration.model_copy(update={"joints": tuple(joints), "tool_version": "older"})


def state_of(arm):
    """Return the registers of every servo after a loss of power, and the text of the file."""
    arm.power_cycle()
    with arm.open_bus() as bus:
        bus.clock.sleep_until(bus.clock.now_s() + 0.5)
        held = {i: read_servo_config(bus, i).registers for i in bus.servos}
    path = calibration_path(arm.name, "")
    return held, path.read_text() if path.exists() else None


def cut_after(arm, outcome, lasts, monkeypatch):
    """Save with power for the given number of writes; return whether it was cut."""
    power = PowerSupply(lasts).limit_files(monkeypatch)
    try:
        with arm.open_bus() as bus:
            limp_arm = TorqueOffArm(load_model(arm.name), bus)
            power.limit_port(arm.port)
            limp_arm.save(outcome)
    except PowerCut:
        pass
    restore_calls(monkeypatch)
    del arm.port.write
    return power.is_cut


def start_again(arm, finish):
    """Restart as a user would: open the arm, and follow the hint of an error."""
    with arm.open_bus() as bus:
        bus.clock.sleep_until(bus.clock.now_s() + 0.5)
        try:
            load_calibration_for(bus, load_model(arm.name), uncalibrated=True)
        except CalibrationError as error:
            hint = error.hint
        else:
            return
        assert "resume" in hint
        assert "revert" in hint
        assert finish(bus, journal_path(arm.name, ""))
        load_calibration_for(bus, load_model(arm.name), uncalibrated=True)


@pytest.mark.sample(2)
@pytest.mark.parametrize("had_file", [False, True], ids=["first time", "again"])
@pytest.mark.parametrize("finish", [resume, roll_back], ids=["resume", "revert"])
@pytest.mark.parametrize("name", ["planar2", pytest.param("planar3", marks=pytest.mark.campaign)])
def test_power_cut_at_any_write_leaves_old_or_new_values(name, finish, had_file, monkeypatch):
    arm, outcome = arm_and_outcome(name)
    before = state_of(arm)[0]
    old_text = dump_calibration(as_delivered(arm, outcome.calibration))
    cuts, ends, lasts = 0, set(), 0
    while True:
        arm = make_mounted_arm(name, 3, spoiled=False)
        path = calibration_path(name, "")
        path.unlink(missing_ok=True)
        if had_file:
            write_atomic(path, old_text)
        if not cut_after(arm, outcome, lasts, monkeypatch):
            break
        arm.power_cycle()
        ends.add(check_consistent(arm, finish, before, outcome, old_text if had_file else None))
        cuts, lasts = cuts + 1, lasts + 1
    assert cuts >= 15
    assert ends == {"old", "new"}


def check_consistent(arm, finish, before, outcome, old_text):
    path = calibration_path(arm.name, "")
    start_again(arm, finish)
    held, text = state_of(arm)
    assert read_journal(journal_path(arm.name, "")) is None
    if held == before:
        assert text == old_text
        return "old"
    assert held == {i: dict(memory) for i, memory in outcome.memory.items()}
    assert text == dump_calibration(outcome.calibration)
    assert read_calibration(path) == outcome.calibration
    return "new"


@pytest.mark.campaign
@pytest.mark.timeout(1200)
def test_thousand_random_power_cuts_leave_old_or_new_values(monkeypatch, tmp_path):
    chance, names = random.Random(12), ["so101", "koch", "px100", "so100", "planar2", "vx300s"]
    truths = {name: arm_and_outcome(name) for name in names}
    olds = {name: state_of(arm)[0] for name, (arm, _) in truths.items()}
    for _ in range(1000):
        name = chance.choice(names)
        calibration_path(name, "").unlink(missing_ok=True)
        arm = make_mounted_arm(name, 3, spoiled=False)
        if cut_after(arm, truths[name][1], chance.randrange(70), monkeypatch):
            arm.power_cycle()
            finish = chance.choice([resume, roll_back])
            check_consistent(arm, finish, olds[name], truths[name][1], None)


def test_cable_lost_during_calibration_save_suggests_resume(monkeypatch):
    arm, outcome = arm_and_outcome("planar2")
    write, writes = arm.port.write, []

    def restore_calls(data):
        writes.extend([data] if is_write(bytes(data)) else [])
        if len(writes) > 4:
            raise OSError("gone")
        return write(data)

    with arm.open_bus() as bus:
        limp_arm = TorqueOffArm(load_model(arm.name), bus)
        arm.port.write = restore_calls
        with pytest.raises(CalibrationError, match=r"(?s)interrupted.*resume.*revert") as caught:
            limp_arm.save(outcome)
    assert caught.value.exit_code is ExitCode.CALIBRATION
    assert isinstance(caught.value.__cause__, PortLostError)


def test_servo_that_refuses_write_causes_full_rollback(monkeypatch):
    arm, outcome = arm_and_outcome("planar2")
    before = state_of(arm)
    arm.line.servos[2].write("torque_enable", 1)
    with arm.open_bus() as bus:
        limp_arm = TorqueOffArm(load_model(arm.name), bus)
        with pytest.raises(Exception, match="torque is on"):
            limp_arm.save(outcome)
    assert state_of(arm) == before
    assert read_journal(journal_path(arm.name, "")) is None


def test_saving_unchanged_registers_does_not_write_eeprom():
    arm, outcome = arm_and_outcome("planar2")
    with arm.open_bus() as bus:
        TorqueOffArm(load_model(arm.name), bus).save(outcome)
    writes = arm.eeprom_writes()
    with arm.open_bus() as bus:
        TorqueOffArm(load_model(arm.name), bus).save(outcome)
    assert arm.eeprom_writes() == writes


def test_eeproms_are_locked_again_after_save():
    arm, outcome = arm_and_outcome("planar2")
    with arm.open_bus() as bus:
        TorqueOffArm(load_model(arm.name), bus).save(outcome)
    assert all(servo.read("lock") == 1 for servo in arm.line.servos.values())


def test_damaged_calibration_journal_gives_one_clear_error():
    path = journal_path("planar2", "")
    write_atomic(path, "checksum = 7\n")
    with pytest.raises(FileFormatError, match=r"Remove it, then .*calibration diff"):
        read_journal(path)


def test_unwritable_calibration_journal_changes_nothing(monkeypatch):
    arm, outcome = arm_and_outcome("planar2")
    before = state_of(arm)
    fsync = os.fsync

    def refuse_folders(handle):
        if stat.S_ISDIR(os.fstat(handle).st_mode):
            raise OSError("broken")
        fsync(handle)

    monkeypatch.setattr("os.fsync", refuse_folders)
    with arm.open_bus() as bus, pytest.raises(FileWriteError):
        TorqueOffArm(load_model(arm.name), bus).save(outcome)
    assert state_of(arm) == before
    assert read_journal(journal_path(arm.name, "")) is None


@pytest.mark.parametrize("act", [recover, resume, roll_back])
@pytest.mark.parametrize("change", [(9, "homing_offset"), (1, "goal_pwm")], ids=["id", "register"])
def test_calibration_journal_of_another_servo_gives_clear_error(act, change):
    arm, _ = arm_and_outcome("planar2")
    before, (servo_id, register) = state_of(arm), change
    changes = (EepromChange(id=servo_id, old={register: 0}, new={register: 5}),)
    path = journal_path("planar2", "")
    journal = Journal(format=1, path="x", old_text="", new_text="", changes=changes)
    write_atomic(path, dump_journal(journal))
    with arm.open_bus() as bus, pytest.raises(CalibrationError, match=f"servo {servo_id}"):
        act(bus, path)
    assert state_of(arm) == before
