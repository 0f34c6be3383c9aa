"""Each command that writes a servo's EEPROM first keeps a copy of it as it was."""

import signal

import pytest

from ikservo.apps.calibrating.calibration_session import open_torque_off
from ikservo.arm.opening import open_bus
from ikservo.calibration.transaction import commit, plan_changes
from ikservo.errors import ExitCode
from ikservo.files.writing import FileWriteError
from ikservo.hardware import backup_path, eeprom, read_backup
from ikservo.hardware.eeprom import write_backup
from ikservo.model import load_model
from tests.cli.fixtures_mounted_arm import PORT, SERIAL, connect_arm

NAME = "planar2"
DELAY = 100  # of a servo that nobody has set up
AT = f"--arm {NAME} --port {PORT}"


def restore(run_cli, arm, folder):
    with open_bus(load_model(NAME), PORT) as bus:
        write_backup(bus, 1, folder / "copy.toml")
    text = (folder / "copy.toml").read_text().replace(f"delay = {DELAY}", "delay = 0")
    (folder / "copy.toml").write_text(text)
    arm.port.is_open = True
    return run_cli(["servo", "restore", str(folder / "copy.toml"), *AT.split(), "--yes"])


WRITERS = {
    "doctor": lambda run_cli, arm, folder: run_cli(f"doctor {AT} --write-eeprom"),
    "write": lambda run_cli, arm, folder: run_cli(
        f"servo write return_delay=0 {AT} --id 1 --yes"
    ),
    "restore": restore,
}  # fmt: skip
EACH = pytest.mark.parametrize("writer", WRITERS.values(), ids=WRITERS)


@pytest.fixture
def home(monkeypatch, tmp_path):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))
    return tmp_path / "home"


@pytest.fixture
def arm(home, monkeypatch):
    arm = connect_arm(monkeypatch, NAME, spoiled=False)
    arm.line.servos[1].memory.put("return_delay", DELAY)
    arm.line.servos[1].memory.persist_value("return_delay")
    return arm


def first_copy():
    with open_bus(load_model(NAME), PORT) as bus:
        return backup_path(f"{NAME}-{SERIAL}", bus.servos[1])


@EACH
def test_eeprom_backup_is_made_before_eeprom_is_written(writer, arm, run_cli, tmp_path):
    writer(run_cli, arm, tmp_path)
    assert arm.register(1, "return_delay") == 0
    assert read_backup(first_copy()).eeprom["return_delay"] == DELAY


@EACH
def test_servo_eeprom_is_not_written_if_its_backup_fails(writer, arm, run_cli, home, tmp_path):
    home.mkdir()
    (home / "backups").write_text("no folder")
    before = arm.eeprom_writes()
    done = writer(run_cli, arm, tmp_path)
    assert done.code == 1
    assert done.err.count("cannot be written") == 1
    assert arm.eeprom_writes() == before
    assert arm.register(1, "lock") == 1


def test_calibration_makes_eeprom_backups_before_its_journal(arm):
    with open_torque_off(load_model(NAME), PORT) as limp_arm:
        before = arm.register(1, "min_position_limit")
        changes = plan_changes(limp_arm.bus, {1: {"min_position_limit": before + 100}})
        commit(limp_arm.bus, limp_arm.journal_path, limp_arm.path, "the new file", changes)
    assert arm.register(1, "min_position_limit") == before + 100
    assert read_backup(first_copy()).eeprom["min_position_limit"] == before


def test_calibration_is_not_written_if_eeprom_backup_fails(arm, home):
    home.mkdir()
    (home / "backups").write_text("no folder")
    before = arm.eeprom_writes()
    with open_torque_off(load_model(NAME), PORT) as limp_arm:
        now = arm.register(1, "min_position_limit")
        changes = plan_changes(limp_arm.bus, {1: {"min_position_limit": now + 100}})
        with pytest.raises(FileWriteError, match="backups"):
            commit(limp_arm.bus, limp_arm.journal_path, limp_arm.path, "the new file", changes)
    assert arm.eeprom_writes() == before
    assert not limp_arm.journal_path.exists()
    assert not limp_arm.path.exists()


@EACH
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_signal_during_eeprom_write_still_locks_eeprom(
    writer, name, arm, run_cli, tmp_path, monkeypatch
):
    """The signal comes when the registers are compared with the memory unlocked."""
    number, original, seen = getattr(signal, name), eeprom.register_differences, []

    def compare(*arguments):
        if arm.register(1, "lock") == 0:
            seen.append(arm.register(1, "return_delay"))
            signal.raise_signal(number)
        return original(*arguments)

    monkeypatch.setattr(eeprom, "register_differences", compare)
    before = signal.signal(number, signal.SIG_IGN)
    try:
        assert writer(run_cli, arm, tmp_path).code == ExitCode.STOPPED
    finally:
        signal.signal(number, before)
    assert (seen, arm.register(1, "lock")) == ([0], 1)
