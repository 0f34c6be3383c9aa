"""Setup configures one servo or reports why it cannot, and locks its memory in any case."""

from pathlib import Path

import pytest

from ikservo.apps.workbench.id_and_baud_rate import ServoSettings, provision
from ikservo.errors import BadValueError, BusError, CalibrationError
from ikservo.hardware import ServoSpec, backup_path, open_port, read_backup
from ikservo.hardware.scan import FoundServo
from ikservo.registers import STS3215, XL330M288, control_table

CONFIGS = Path(__file__).parents[3] / "configs"
TABLES = {"so101": STS3215, "koch": XL330M288}


@pytest.fixture(params=["so101", "koch"])
def alone(request):
    """Return a port with only servo 3 plugged in, the servo, and its table."""
    port = open_port(f"sim:{CONFIGS / request.param / 'arm.toml'}", 1_000_000)
    line = port.transport.line
    for servo in line.world.servos:
        servo.powered = servo.id == 3
    yield port, line.servos[3], TABLES[request.param]
    port.close()


def found(table, servo_id=3, rate=1_000_000):
    return FoundServo(servo_id, rate, "", table, table.number)


def settings(table, servo_id=7, rate=57_600, **eeprom):
    return ServoSettings(ServoSpec(servo_id, table, "wrist"), rate, eeprom)


def test_provisioning_sets_id_baud_rate_and_delay_permanently(alone):
    port, servo, table = alone
    provision(port, found(table), settings(table))
    servo.memory.power_cycle()
    assert (servo.id, servo.baud, servo.return_delay_s) == (7, 57_600, 0.0)
    assert port.baudrate == 57_600


def test_provisioning_first_backs_up_eeprom_under_new_id(alone, tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    port, _, table = alone
    for seen in (found(table), found(table, 7, 57_600)):
        provision(port, seen, settings(table), "bench")
        backup = read_backup(backup_path("bench", settings(table).servo))
        assert (backup.servo_id, backup.eeprom["id"]) == (7, 3)


def test_provisioning_switches_torque_off(alone):
    port, servo, table = alone
    servo.write("torque_enable", 1)
    provision(port, found(table), settings(table))
    assert servo.read("torque_enable") == 0


def test_provisioning_skips_registers_already_correct(alone):
    port, servo, table = alone
    provision(port, found(table), settings(table))
    writes = servo.memory.eeprom_writes
    assert provision(port, found(table, 7, 57_600), settings(table)) == ()
    assert servo.memory.eeprom_writes == writes


def test_provisioning_writes_and_reports_arm_file_settings(alone):
    port, servo, table = alone
    before = servo.read("max_position_limit")
    written = provision(port, found(table), settings(table, max_position_limit=3000))
    assert f"max_position_limit {before} → 3000" in written
    assert servo.read("max_position_limit") == 3000


def test_provisioning_refuses_other_model(alone):
    port, servo, table = alone
    writes = servo.memory.eeprom_writes
    with pytest.raises(CalibrationError, match="must be a XM540-W270, but a"):
        provision(port, found(table), settings(control_table("XM540-W270")))
    assert servo.memory.eeprom_writes == writes


def test_provisioning_refuses_baud_rate_unsupported_by_model(alone):
    port, servo, table = alone
    writes = servo.memory.eeprom_writes
    with pytest.raises(BadValueError, match=r"one of (9600|4800), "):
        provision(port, found(table), settings(table, rate=123_456))
    assert servo.memory.eeprom_writes == writes


def test_provisioning_refuses_register_missing_in_model(alone):
    port, servo, table = alone
    writes = servo.memory.eeprom_writes
    with pytest.raises(BadValueError, match="'colour'"):
        provision(port, found(table), settings(table, colour=3))
    assert servo.memory.eeprom_writes == writes


def test_provisioning_detects_worn_out_eeprom(alone, monkeypatch):
    port, servo, table = alone
    row = servo.table.by_name["id"]
    keep = servo.memory.write

    def worn(address, data, *, persist=True):
        if address != row.address:
            keep(address, data, persist=persist)

    monkeypatch.setattr(servo.memory, "write", worn)
    with pytest.raises(BusError):
        provision(port, found(table), settings(table))
    assert servo.id == 3


def test_provisioning_locks_memory_after_failure(monkeypatch):
    port = open_port(f"sim:{CONFIGS / 'so101' / 'arm.toml'}", 1_000_000)
    servo = port.transport.line.servos[3]
    row = servo.table.by_name["max_torque"]
    keep = servo.memory.write

    def worn(address, data, *, persist=True):
        if address != row.address:
            keep(address, data, persist=persist)

    monkeypatch.setattr(servo.memory, "write", worn)
    with pytest.raises(BusError, match="max_torque"):
        provision(port, found(STS3215), settings(STS3215, max_torque=500))
    assert servo.read("lock") == 1
    port.close()
