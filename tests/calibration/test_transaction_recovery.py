"""An interrupted transaction on servos and file: its progress, and its recovery."""

import pytest

from ikservo.calibration.calibration_file import dump_calibration
from ikservo.calibration.transaction import (
    EepromChange,
    Journal,
    TransactionProgress,
    commit,
    dump_journal,
    plan_changes,
    progress,
    read_journal,
    recover,
    resume,
    roll_back,
)
from ikservo.errors import CalibrationError, FileFormatError, IkservoError
from ikservo.files.writing import FileWriteError, write_atomic
from tests.calibration.mounted_arms import make_mounted_arm
from tests.calibration.records import calibration_of, joint

REGISTER, OLD, NEW = "homing_offset", 11, 500
OLD_TEXT, NEW_TEXT = dump_calibration(calibration_of(joint())), "[new]\n"


class Interrupted:
    """Servos, a calibration file, and the journal of a transaction on both."""

    def __init__(self, folder, name="planar2"):
        self.path, self.journal_path = folder / "arm.toml", folder / "journal.toml"
        self.arm = make_mounted_arm(name, 3, spoiled=False)
        self.ids = sorted(self.arm.line.servos)
        self.path.write_text(OLD_TEXT)
        for servo_id in self.ids:
            self.hold(servo_id, OLD)

    def hold(self, servo_id, number):
        self.arm.line.servos[servo_id].write(REGISTER, number)

    def held(self):
        return [self.arm.register(servo_id, REGISTER) for servo_id in self.ids]

    def journal(self, *, old_text=OLD_TEXT, new_text=NEW_TEXT):
        changes = tuple(
            EepromChange(id=i, old={REGISTER: OLD}, new={REGISTER: NEW}) for i in self.ids
        )
        return Journal(
            format=1, path=str(self.path), old_text=old_text, new_text=new_text, changes=changes
        )

    def leave_journal(self, **texts):
        write_atomic(self.journal_path, dump_journal(self.journal(**texts)))
        return self

    def act(self, action):
        with self.arm.open_bus() as bus:
            return action(bus, self.journal_path)

    def is_over(self):
        return read_journal(self.journal_path) is None


@pytest.fixture
def interrupted(tmp_path):
    return Interrupted(tmp_path)


@pytest.fixture
def commit_new(interrupted):
    """Return a function that writes the new registers and the new file."""
    changes = interrupted.journal().changes

    def act(bus, journal_path):
        commit(bus, journal_path, interrupted.path, NEW_TEXT, changes)

    return lambda: interrupted.act(act)


# --- a writing that is not interrupted, and one that fails


@pytest.mark.parametrize("kept", [OLD_TEXT, None])
def test_calibration_commit_writes_servos_file_and_backup(interrupted, commit_new, kept):
    if kept is None:
        interrupted.path.unlink()
    commit_new()
    backup = interrupted.path.with_name("arm.toml.bak")
    assert (interrupted.held(), interrupted.path.read_text()) == ([NEW, NEW], NEW_TEXT)
    assert (backup.read_text() if backup.exists() else None) == kept
    assert interrupted.is_over()


@pytest.mark.parametrize("text", [OLD_TEXT, None])
def test_calibration_refused_by_second_servo_changes_nothing(interrupted, commit_new, text):
    if text is None:
        interrupted.path.unlink()
    interrupted.arm.line.servos[2].write("torque_enable", 1)
    with pytest.raises(IkservoError, match="torque is on"):
        commit_new()
    assert interrupted.held() == [OLD, OLD]
    assert (interrupted.path.read_text() if interrupted.path.exists() else None) == text
    assert interrupted.is_over()


def test_calibration_commit_with_unwritable_file_restores_servos(interrupted, commit_new):
    interrupted.path.with_name("arm.toml.bak").mkdir()  # where the old file would be kept
    with pytest.raises(FileWriteError):
        commit_new()
    assert (interrupted.held(), interrupted.path.read_text()) == ([OLD, OLD], OLD_TEXT)
    assert interrupted.is_over()


def test_calibration_commit_with_lost_cable_leaves_full_journal(
    interrupted, commit_new, monkeypatch
):
    def refuse(data):
        raise OSError("gone")

    monkeypatch.setattr(interrupted.arm.port, "write", refuse)
    with pytest.raises(CalibrationError, match=r"(?s)interrupted.*resume.*revert"):
        commit_new()
    assert read_journal(interrupted.journal_path) == interrupted.journal()


@pytest.mark.parametrize("ending", [KeyboardInterrupt(), SystemExit(143)], ids=repr)
def test_calibration_commit_ended_by_signal_restores_servos(
    interrupted, commit_new, monkeypatch, ending
):
    def end(*_, **__):
        raise ending

    monkeypatch.setattr("ikservo.calibration.transaction.replace_calibration", end)
    with pytest.raises(type(ending)):
        commit_new()
    assert (interrupted.held(), interrupted.path.read_text()) == ([OLD, OLD], OLD_TEXT)
    assert interrupted.is_over()


DAMAGED = "[old]\n\u00e4".encode()[:-1]  # cut in the middle of a letter


def test_calibration_commit_replaces_file_that_is_not_utf8(interrupted, commit_new):
    interrupted.path.write_bytes(DAMAGED)
    commit_new()
    assert (interrupted.held(), interrupted.path.read_text()) == ([NEW, NEW], NEW_TEXT)
    assert interrupted.is_over()


def test_failed_calibration_commit_keeps_file_that_is_not_utf8(interrupted, commit_new):
    interrupted.path.write_bytes(DAMAGED)
    interrupted.path.with_name("arm.toml.damaged").mkdir()  # where the old file would be kept
    with pytest.raises(FileWriteError):
        commit_new()
    assert (interrupted.held(), interrupted.path.read_bytes()) == ([OLD, OLD], DAMAGED)
    assert interrupted.is_over()


def test_commit_refuses_folder_in_place_of_calibration_file(interrupted, commit_new):
    interrupted.path.unlink()
    interrupted.path.mkdir()
    with pytest.raises(FileFormatError, match="is a folder"):
        commit_new()
    assert (interrupted.held(), interrupted.is_over()) == ([OLD, OLD], True)


# --- how far it came


@pytest.mark.parametrize(
    ("written", "reached"),
    [
        ((), TransactionProgress.NOTHING),
        ((1,), TransactionProgress.SOME),
        ((2,), TransactionProgress.SOME),
        ((1, 2), TransactionProgress.EVERYTHING),
    ],
)
def test_calibration_write_progress_is_read_from_servos(interrupted, written, reached):
    for servo_id in written:
        interrupted.hold(servo_id, NEW)
    assert interrupted.act(lambda bus, _: progress(bus, interrupted.journal())) is reached


def test_calibration_writes_only_servos_that_differ(interrupted):
    interrupted.hold(2, NEW)
    wanted = {i: {REGISTER: NEW} for i in interrupted.ids}
    changes = interrupted.act(lambda bus, _: plan_changes(bus, wanted))
    assert changes == [EepromChange(id=1, old={REGISTER: OLD}, new={REGISTER: NEW})]


def test_calibration_recovery_without_journal_does_nothing(interrupted):
    assert interrupted.act(recover) == ""
    assert interrupted.act(resume) is False
    assert interrupted.act(roll_back) is False
    assert interrupted.held() == [OLD, OLD]


def test_recovery_drops_calibration_not_yet_written_to_servos(interrupted):
    interrupted.leave_journal().path.write_text(NEW_TEXT)
    assert "had not changed anything yet" in interrupted.act(recover)
    assert (interrupted.path.read_text(), interrupted.is_over()) == (OLD_TEXT, True)


def test_recovery_saves_calibration_if_all_servos_were_written(interrupted):
    interrupted.leave_journal()
    for servo_id in interrupted.ids:
        interrupted.hold(servo_id, NEW)
    assert "its file has now been saved" in interrupted.act(recover)
    assert (interrupted.path.read_text(), interrupted.is_over()) == (NEW_TEXT, True)


def test_recovery_of_partly_written_calibration_asks_operator(interrupted):
    interrupted.leave_journal().hold(2, NEW)
    with pytest.raises(
        CalibrationError, match=r"(?s)some servos hold the new values.*resume.*revert"
    ):
        interrupted.act(recover)
    assert (interrupted.path.read_text(), interrupted.is_over()) == (OLD_TEXT, False)


@pytest.mark.parametrize(
    ("action", "number", "text"), [(resume, NEW, NEW_TEXT), (roll_back, OLD, OLD_TEXT)]
)
def test_partly_written_calibration_is_resumed_or_rolled_back(interrupted, action, number, text):
    interrupted.leave_journal().hold(2, NEW)
    assert interrupted.act(action) is True
    assert interrupted.held() == [number, number]
    assert (interrupted.path.read_text(), interrupted.is_over()) == (text, True)


# --- the file


def test_calibration_commit_of_empty_text_leaves_no_file(interrupted):
    changes = interrupted.journal().changes
    interrupted.act(lambda bus, journal: commit(bus, journal, interrupted.path, "", changes))
    assert interrupted.held() == [NEW, NEW]
    assert not interrupted.path.exists()


def test_rollback_of_first_calibration_leaves_no_file(interrupted):
    interrupted.leave_journal(old_text="")
    interrupted.act(roll_back)
    assert not interrupted.path.exists()


@pytest.mark.parametrize("left", [None, "", NEW_TEXT])
def test_calibration_rollback_restores_old_file(interrupted, left):
    interrupted.leave_journal()
    interrupted.path.unlink() if left is None else interrupted.path.write_text(left)
    interrupted.act(roll_back)
    assert interrupted.path.read_text() == OLD_TEXT


@pytest.mark.parametrize("left", [None, "", OLD_TEXT])
def test_calibration_resume_writes_new_file(interrupted, left):
    interrupted.leave_journal()
    interrupted.path.unlink() if left is None else interrupted.path.write_text(left)
    interrupted.act(resume)
    assert interrupted.path.read_text() == NEW_TEXT


@pytest.mark.parametrize(("action", "text"), [(resume, NEW_TEXT), (roll_back, OLD_TEXT)])
def test_recovery_does_not_rewrite_correct_calibration_file(interrupted, action, text):
    interrupted.leave_journal().path.write_text(text)
    before = interrupted.path.stat().st_ino
    interrupted.act(action)
    assert interrupted.path.stat().st_ino == before  # writing puts another file in its place


# --- the locks of EEPROMs


@pytest.mark.parametrize(
    ("action", "number"), [(recover, OLD), (recover, NEW), (resume, NEW), (roll_back, OLD)]
)
def test_recovery_locks_eeprom_of_servo_left_unlocked(interrupted, action, number):
    interrupted.leave_journal()
    for servo_id in interrupted.ids:
        interrupted.hold(servo_id, number)
    interrupted.arm.line.servos[2].write("lock", 0)
    interrupted.act(action)
    assert [interrupted.arm.register(i, "lock") for i in interrupted.ids] == [1, 1]


def test_recovery_writes_nothing_if_servo_is_already_locked(interrupted, monkeypatch):
    interrupted.leave_journal()
    with interrupted.arm.open_bus() as bus:
        monkeypatch.setattr(bus, "write", lambda *_, **__: pytest.fail("a register was written"))
        recover(bus, interrupted.journal_path)


def test_recovery_skips_servos_without_eeprom_lock(tmp_path):
    dynamixels = Interrupted(tmp_path, "open_manipulator_x").leave_journal()
    assert "had not changed anything yet" in dynamixels.act(recover)


# --- a journal of other servos


@pytest.mark.parametrize(("old", "new"), [({"goal_pwm": 0}, {}), ({}, {"goal_pwm": 0})])
def test_recovery_refuses_registers_missing_in_servo(interrupted, old, new):
    changes = (EepromChange(id=1, old={REGISTER: OLD} | old, new={REGISTER: OLD} | new),)
    journal = interrupted.journal().model_copy(update={"changes": changes})
    write_atomic(interrupted.journal_path, dump_journal(journal))
    with pytest.raises(CalibrationError, match="servo 1, which has changed since"):
        interrupted.act(recover)
