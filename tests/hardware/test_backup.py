"""Backups of a servo's EEPROM from before the first write."""

from __future__ import annotations

import pytest

from ikservo.errors import FileFormatError, ServoSilentError
from ikservo.hardware import back_up_once, backup_path, read_backup, read_eeprom, update_eeprom
from ikservo.registers import STS3215, RegisterName

from .factories import add_faults, make_bus


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    return tmp_path


@pytest.fixture
def bus():
    return make_bus({1: "STS3215", 2: "XL430-W250"})


def test_backup_writes_one_file_per_servo(bus, home):
    names = [path.relative_to(home).as_posix() for path in back_up_once(bus, "so101")]
    assert names == ["backups/so101/id_001_STS3215.toml", "backups/so101/id_002_XL430-W250.toml"]


def test_eeprom_backup_contains_whole_eeprom(bus):
    path, _ = back_up_once(bus, "so101")
    assert read_backup(path).eeprom == read_eeprom(bus, 1)


def test_first_eeprom_backup_is_never_overwritten(bus):
    back_up_once(bus, "so101")
    update_eeprom(bus, 1, {STS3215.homing_offset: -100})
    assert back_up_once(bus, "so101") == []
    assert read_backup(backup_path("so101", bus.servos[1])).eeprom["homing_offset"] == 0


def test_servo_of_another_model_at_same_id_gets_own_backup(bus):
    back_up_once(bus, "so101")
    assert len(back_up_once(make_bus({1: "STS3250"}), "so101")) == 1


def test_eeprom_backup_of_silent_servo_leaves_no_file(bus, home):
    add_faults(bus, ("silent", {"id": 2}))
    with pytest.raises(ServoSilentError):
        back_up_once(bus, "so101")
    assert [path.name for path in home.rglob("id_*")] == ["id_001_STS3215.toml"]


def test_arm_name_cannot_escape_backup_folder(bus, home):
    (path, _) = back_up_once(bus, "../../etc/arm")
    assert path.is_relative_to(home / "backups")


def test_eeprom_backup_writes_nothing_to_servo(bus):
    torque = bus.read(1, RegisterName.TORQUE_ENABLE)
    sent, write = [], bus.port.transport.write
    bus.port.transport.write = lambda data: (sent.append(bytes(data)), write(data))[1]
    back_up_once(bus, "so101")
    assert torque == 0
    instructions = {packet[7] if packet[:3] == b"\xff\xff\xfd" else packet[4] for packet in sent}
    assert instructions == {0x82}  # sync read


@pytest.mark.parametrize(
    "text", ["", "format = 2\n[eeprom]", "format = 1", 'format = 1\n[eeprom]\nid = "1"', "= ="]
)
def test_file_that_is_not_a_backup_is_refused(tmp_path, text):
    path = tmp_path / "copy.toml"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=r"copy\.toml"):
        read_backup(path)


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ('"STS3215"', '"STS9999"', "model: is 'STS9999'"),
        ("id = 1\n\n", "id = -1\n\n", "id: is -1"),
        ("homing_offset = 0\n", "", "lacks homing_offset"),
        (
            "homing_offset",
            "homing_ofset",
            "eeprom.homing_ofset: is not an EEPROM register of STS3215",
        ),
        ("homing_offset = 0", "homing_offset = 0.5", "homing_offset: is 0.5"),
        ("homing_offset = 0", "homing_offset = 5000", "homing_offset: is 5000"),
        ("homing_offset = 0", "homing_offset = true", "homing_offset: is True"),
    ],
)
def test_refusal_of_damaged_backup_names_damaged_field(bus, old, new, why):
    path, _ = back_up_once(bus, "so101")
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(FileFormatError) as failed:
        read_backup(path)
    assert why in str(failed.value)


def test_backup_names_its_model_id_and_path(bus):
    _, path = back_up_once(bus, "so101")
    backup = read_backup(path)
    assert (backup.table.model_name, backup.servo_id, backup.path) == ("XL430-W250", 2, path)


@pytest.mark.parametrize(("old", "new"), [
    ('"STS3215"', f'"{"x" * 5000}"'), ("id = 1\n\n", f"id = [{'1, ' * 2000}]\n\n"),
    ("homing_offset = 0", f'homing_offset = "{"y" * 5000}"'),
])  # fmt: skip
def test_error_text_of_damaged_backup_is_truncated(bus, old, new):
    path, _ = back_up_once(bus, "so101")
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(FileFormatError) as failed:
        read_backup(path)
    assert len(failed.value.message) < 600 + len(str(path))
