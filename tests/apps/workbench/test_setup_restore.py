"""``ikservo setup --restore``: a servo's EEPROM is restored from its backup."""

import json

import pytest

from ikservo.arm.opening import open_bus
from ikservo.errors import ExitCode
from ikservo.hardware import back_up_once
from ikservo.model import load_model
from servosim.faults import Fault
from tests.cli.fixtures_ports import change_bus, run_arguments

SPOILED = {
    "so101": {"homing_offset": -100, "p_gain": 40, "max_position_limit": 3000},
    "koch": {"homing_offset": -100, "temperature_limit": 60, "pwm_limit": 500},
}
EACH = pytest.mark.parametrize("arm", SPOILED)
ID = 3


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    monkeypatch.delenv("IKSERVO_ARM", raising=False)


def backup_of(arm, servo_id=ID):
    """Return the backup of a servo as delivered, and its registers."""
    with open_bus(load_model(arm), "sim") as bus:
        (path,) = back_up_once(bus, arm, [servo_id])
    return path


def change(servo, numbers):
    for name, number in numbers.items():
        servo.memory.put(name, number)
        servo.memory.persist_value(name)


class ChangedServoLine:
    """The simulated line of the command, with a servo whose EEPROM has been changed."""

    def __init__(self, monkeypatch, arm, numbers=None, servo_id=ID, also=lambda line: None):
        self.arm, self.servo_id = arm, servo_id
        self.numbers = SPOILED[arm] if numbers is None else numbers
        self.before = {}

        def spoiled(line):
            servo = line.servos[servo_id]
            self.before = {name: servo.read(name) for name in self.numbers}
            change(servo, self.numbers)
            also(line)

        self._ports = change_bus(monkeypatch, spoiled)

    def restore(self, path, *words):
        return run_arguments(["setup", self.arm, "--port", "sim", "--restore", str(path), *words])

    @property
    def servo(self):
        return self._ports[-1].line.servos[self.servo_id]

    def held(self):
        """Return the servo's registers after a loss of power."""
        self.servo.power_down()
        self.servo.power_up()
        return {name: self.servo.read(name) for name in self.numbers}


def edited(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return path


@EACH
def test_restore_lists_and_writes_differing_registers(monkeypatch, arm):
    path, bench_line = backup_of(arm), ChangedServoLine(monkeypatch, arm)
    result = bench_line.restore(path, "--yes")
    assert result.code == 0, result.err
    assert "elbow_flex (id 3): 3 registers to restore." in result.err
    for name, number in SPOILED[arm].items():
        assert f"    {name} {number} → {bench_line.before[name]}" in result.err
        assert f"{name} {number} → {bench_line.before[name]}" in result.out
    assert "ikservo doctor" in result.err
    assert bench_line.held() == bench_line.before != SPOILED[arm]


def test_restore_locks_eeprom_again(monkeypatch):
    path, bench_line = backup_of("so101"), ChangedServoLine(monkeypatch, "so101")
    bench_line.restore(path, "--yes")
    assert bench_line.servo.read("lock") == 1


@EACH
def test_restore_without_difference_needs_no_confirmation(monkeypatch, arm):
    path, bench_line = backup_of(arm), ChangedServoLine(monkeypatch, arm, {})
    result = bench_line.restore(path)  # without --yes, and without a terminal
    assert (result.code, result.out) == (0, "✓ elbow_flex (id 3): nothing to change\n")
    assert "no registers to restore" in result.err


def test_restore_without_terminal_needs_yes_option(monkeypatch):
    path, bench_line = backup_of("so101"), ChangedServoLine(monkeypatch, "so101")
    result = bench_line.restore(path)
    assert result.code == ExitCode.USAGE
    assert "Give --yes." in result.err
    assert bench_line.held() == SPOILED["so101"]


@pytest.mark.parametrize("answer", [True, False])
def test_restore_writes_only_after_confirmation(monkeypatch, answer):
    path, bench_line = backup_of("so101"), ChangedServoLine(monkeypatch, "so101")
    asked = []
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr(
        "ikservo.cli.terminal_dialogue.confirm", lambda q: (asked.append(q), answer)[1]
    )
    result = bench_line.restore(path)
    assert asked == ["Write these to elbow_flex (id 3)?"]
    assert (result.code == 0) is answer
    assert bench_line.held() == (bench_line.before if answer else SPOILED["so101"])


@EACH
def test_restore_json_lists_written_registers(monkeypatch, arm):
    path, bench_line = backup_of(arm), ChangedServoLine(monkeypatch, arm)
    report = json.loads(bench_line.restore(path, "--yes", "--json").out)
    assert (report["joint"], report["id"], report["kept"]) == ("elbow_flex", 3, [])
    assert len(report["written"]) == len(SPOILED[arm])


@EACH
def test_restore_with_torque_on_writes_nothing(monkeypatch, arm):
    def hold(line):
        line.servos[ID].write("torque_enable", 1)

    path, bench_line = backup_of(arm), ChangedServoLine(monkeypatch, arm, also=hold)
    result = bench_line.restore(path, "--yes")
    assert result.code != 0
    assert "torque is on" in result.err
    assert bench_line.held() == SPOILED[arm]


def test_backup_of_unknown_id_needs_servo_option(monkeypatch):
    path = backup_of("so101")
    edited(path, "\nid = 3\n\n", "\nid = 9\n\n")
    bench_line = ChangedServoLine(monkeypatch, "so101")
    result = bench_line.restore(path, "--yes")
    assert result.code == ExitCode.USAGE
    assert "the servo with id 9, which the arm does not have" in result.err
    assert "--servo JOINT" in result.err
    assert bench_line.restore(path, "--yes", "--servo", "elbow_flex").code == 0
    assert bench_line.held() == bench_line.before


def test_backup_is_restored_to_its_id_unless_servo_is_given(monkeypatch):
    path, bench_line = backup_of("so101", 2), ChangedServoLine(monkeypatch, "so101", {"p_gain": 40})
    assert "nothing to change" in bench_line.restore(path, "--yes").out
    result = bench_line.restore(path, "--yes", "--servo", "3")
    assert "id stays 3; the backup has 2" in result.err
    assert bench_line.held() == bench_line.before
    assert bench_line.servo.read("id") == 3


def test_backup_of_other_model_needs_other_model_option(monkeypatch):
    path, bench_line = backup_of("so101"), ChangedServoLine(monkeypatch, "so101")
    edited(path, '"STS3215"', '"STS3250"')
    result = bench_line.restore(path, "--yes")
    assert result.code == ExitCode.USAGE
    assert "is a backup of a STS3250; elbow_flex (id 3) is a STS3215." in result.err
    assert bench_line.restore(path, "--yes", "--other-model").code == 0
    assert bench_line.held() == bench_line.before


def test_restore_refuses_servo_of_other_model_than_arm_file(monkeypatch):
    path = backup_of("so101")
    bench_line = ChangedServoLine(monkeypatch, "so101", {"model_number": 2825, "p_gain": 40})
    result = bench_line.restore(path, "--yes")
    assert result.code == ExitCode.CALIBRATION
    assert "must be a STS3215, but reports model 2825" in result.err
    assert bench_line.held()["p_gain"] == 40


def test_restore_refuses_invalid_value_before_first_write(monkeypatch):
    path, bench_line = backup_of("so101"), ChangedServoLine(monkeypatch, "so101")
    edited(path, f"overload_torque = {80}", "overload_torque = 255")
    result = bench_line.restore(path, "--yes")
    assert "255 is outside 0 to 254" in result.err
    assert bench_line.held() == SPOILED["so101"]


def test_restore_keeps_id_and_baud_rate(monkeypatch):
    path, bench_line = backup_of("so101"), ChangedServoLine(monkeypatch, "so101", {"p_gain": 40})
    edited(path, "baud_rate = 0", "baud_rate = 4")
    result = bench_line.restore(path, "--yes")
    assert "baud_rate stays 0; the backup has 4" in result.err
    assert bench_line.held() == bench_line.before
    assert bench_line.servo.read("baud_rate") == 0


@EACH
@pytest.mark.parametrize("keep", [0.0, 0.3, 0.9])
def test_damaged_backup_gives_one_clear_error(monkeypatch, arm, keep):
    path, bench_line = backup_of(arm), ChangedServoLine(monkeypatch, arm)
    text = path.read_text()
    path.write_text(text[: int(keep * len(text))])
    result = bench_line.restore(path, "--yes")
    assert result.code == ExitCode.USAGE
    assert path.name in result.err
    assert "Traceback" not in result.err
    assert result.err.count("rror") <= 1


def test_restore_names_silent_servo(monkeypatch):
    def mute(line):
        line.faults.add(Fault("silent", id=ID))

    path, bench_line = backup_of("so101"), ChangedServoLine(monkeypatch, "so101", also=mute)
    result = bench_line.restore(path, "--yes")
    assert result.code != 0
    assert "elbow_flex (id 3)" in result.err


def test_other_model_option_without_restore_is_refused(monkeypatch):
    ChangedServoLine(monkeypatch, "so101")
    result = run_arguments(["setup", "so101", "--port", "sim", "--other-model"])
    assert result.code == ExitCode.USAGE
    assert "Add --restore FILE." in result.err


def test_restore_without_arm_names_missing_argument():
    result = run_arguments(["setup", "--restore", "x.toml"])
    assert result.code == ExitCode.USAGE
    assert "Missing argument 'ARM'." in result.err
