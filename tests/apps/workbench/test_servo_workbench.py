"""Registers of every model: read, written, restored; killed writes, ids, factory settings."""

import pytest

from ikservo.apps.workbench.eeprom_restore import plan_restoration, write_restoration
from ikservo.apps.workbench.servo_workbench import (
    ServoLine,
    find_register,
    parse_register_value,
    plan_writes,
    read_registers,
    reset_servo,
    restart_servo,
    write_registers,
)
from ikservo.errors import (
    BadValueError,
    BusError,
    InputError,
    PortError,
    RegisterAccessError,
    UnknownNameError,
)
from ikservo.hardware import Port, ServoBus, ServoSpec, torque_on
from ikservo.hardware.eeprom import read_backup, read_eeprom, write_backup
from ikservo.registers import MODELS, Access, Area, Family, RegisterName, control_table
from tests.hardware.factories import make_bus, simulated_servos

ID = 7


def each_model(test):
    return pytest.mark.sample(4)(pytest.mark.parametrize("model", MODELS)(test))


TICKING = {"realtime_tick"}
SEVERAL_EFFECTS = {  # written by tests of their own, or with an effect on the line
    "id", "baud_rate", "protocol_type", "torque_enable", "lock", "response_level",
    "status_return_level", "shutdown", "secondary_shadow_id", "operating_mode", "control_mode",
    "drive_mode", "min_voltage_limit", "max_voltage_limit", "lowest_voltage_limit",
    "highest_voltage_limit", "secondary_id", "phase", "registered", "registered_instruction",
    "led_alarm", "unload_condition", "alarm_led", "alarm_shutdown",
}  # fmt: skip


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))


def line_of(model, **more):
    return ServoLine(make_bus({1: model, ID: model}, **more))


def servo_of(line):
    return line.bus.servos[ID]


def write(line, values, servo=None):
    servo = servo or servo_of(line)
    registers = {find_register(servo.table, name): raw for name, raw in values.items()}
    write_registers(line, servo, plan_writes(line, servo, registers))


@each_model
def test_register_readings_match_servo_memory(model):
    line = line_of(model)
    held = simulated_servos(line.bus)[ID]
    readings = read_registers(line, servo_of(line))
    assert {one.register.name: one.raw for one in readings if one.register.name not in TICKING} == {
        name: held.read(name) for name in MODELS[model].registers if name not in TICKING
    }


@each_model
def test_each_writable_register_is_written_and_restored(model):
    line = line_of(model)
    held = simulated_servos(line.bus)[ID]
    for name, register in MODELS[model].registers.items():
        if register.access is Access.RO or name in SEVERAL_EFFECTS or name.startswith("goal_"):
            continue
        before, (lower, upper) = held.read(name), register.range
        if lower == upper:
            continue
        other = before - 1 if before - 1 >= lower else before + 1
        write(line, {name: other})
        assert held.read(name) == other, name
        write(line, {name: before})
        assert held.read(name) == before, name


@each_model
def test_value_outside_data_sheet_range_is_refused(model):
    line = line_of(model)
    for register in MODELS[model].registers.values():
        lower, upper = register.range
        beyond = [upper + 1] if lower == 0 else [lower - 1, upper + 1]
        for raw in beyond if register.access is Access.RW else [0]:
            with pytest.raises(RegisterAccessError):
                plan_writes(line, servo_of(line), {register: raw})


@each_model
def test_eeprom_write_under_torque_is_refused(model):
    line = line_of(model)
    table = MODELS[model]
    torque_on(line.bus, ID)
    name = next(n for n, r in table.registers.items() if r.area is Area.EEPROM
                and r.access is Access.RW and n not in SEVERAL_EFFECTS)  # fmt: skip
    now = line.bus.read(ID, table.registers[name], raw=True)
    lower, upper = table.registers[name].range
    with pytest.raises(RegisterAccessError, match="torque is on"):
        write(line, {name: now - 1 if now > lower else min(now + 1, upper)})


@each_model
def test_new_id_and_baud_rate_are_written_and_verified(model):
    line = line_of(model)
    table, servo = MODELS[model], servo_of(line)
    with pytest.raises(InputError, match="belongs to another servo"):
        write(line, {"id": 1})
    code = next(c for c, r in table.baud_rates.items() if r not in (1_000_000, 0))
    write(line, {table.id.name: 9, table.baud_rate.name: code})
    assert line.bus.port.baudrate == table.baud_rates[code]
    moved = ServoBus(line.bus.port, [ServoSpec(9, table)])
    assert moved.read(9, table.id, raw=True) == 9
    assert servo.id not in simulated_servos(line.bus)


KILLED_AT = 100


@pytest.mark.parametrize("model", ["STS3215", "SCS0009"])
def test_killed_write_is_finished_by_next_write(model):
    """Every packet after a given one is lost for this program, as after SIGKILL."""
    table = control_table(model)
    values = {"p_gain": 20, "d_gain": 10, "max_temperature_limit": 60}
    left_unlocked = 0
    for packets in range(KILLED_AT):
        line = line_of(model)
        transport = line.bus.port.transport
        killed = ServoLine(ServoBus(Port(_DyingTransport(transport, packets), "dying", 1_000_000),
                                    [servo_of(line)], retries=0))  # fmt: skip
        done = True
        try:
            write(killed, values)
        except (PortError, BusError):
            done = False
        held = simulated_servos(line.bus)[ID]
        left_unlocked += held.read(table.eeprom_lock.name) == 0
        line.bus.port.clock.sleep_until(line.bus.port.clock.now_s() + 1.0)
        write(line, values)
        assert held.read(table.eeprom_lock.name) == 1
        assert {name: held.read(name) for name in values} == values
        if done:
            break
    assert left_unlocked > 2, "no packet was lost between unlock and lock"


SPOILED = {"p_gain": 20, "d_gain": 10, "max_temperature_limit": 60, "max_position_limit": 900}


@pytest.mark.parametrize("model", ["STS3215", "SCS0009"])
def test_restore_after_killed_restore_yields_backup_values(model, tmp_path):
    first, second = tmp_path / "first.toml", tmp_path / "second.toml"
    for packets in range(KILLED_AT):
        line = line_of(model)
        write_backup(line.bus, ID, first)
        write(line, SPOILED)
        dying = _DyingTransport(line.bus.port.transport, packets)
        killed = ServoBus(Port(dying, "dying", 1_000_000), [servo_of(line)], retries=0)
        done = True
        try:
            write_restoration(killed, plan_restoration(killed, read_backup(first)))
        except (PortError, BusError):
            done = False
        line.bus.port.clock.sleep_until(line.bus.port.clock.now_s() + 1.0)
        write_restoration(line.bus, plan_restoration(line.bus, read_backup(first)))
        write_backup(line.bus, ID, second)
        assert second.read_text() == first.read_text()
        if done:
            break
    assert packets > 4


class _DyingTransport:
    """Loses every packet after the first few, like the line of a killed program."""

    def __init__(self, transport, packets):
        object.__setattr__(self, "_transport", transport)
        object.__setattr__(self, "_left", packets)

    def write(self, data):
        object.__setattr__(self, "_left", self._left - 1)
        if self._left < 0:
            raise OSError(5, "killed")
        return self._transport.write(data)

    def __getattr__(self, name):
        return getattr(self._transport, name)

    def __setattr__(self, name, value):
        setattr(self._transport, name, value)


@each_model
def test_servo_factory_reset_keeps_id_and_baud_or_is_refused(model):
    line = line_of(model)
    family = MODELS[model].family
    held = simulated_servos(line.bus)[ID]
    fresh = read_eeprom(line.bus, ID)
    name = "p_gain" if "p_gain" in fresh else "max_torque" if "max_torque" in fresh else ""
    name = name or next(n for n in fresh if n.endswith("temperature_limit"))
    write(line, {name: fresh[name] - 1})
    if family is Family.DYNAMIXEL_1:
        with pytest.raises(BusError, match="restore a backup"):
            reset_servo(line, servo_of(line))
        return
    reset_servo(line, servo_of(line))
    assert (held.read("id"), line.bus.port.baudrate) == (ID, 1_000_000)
    assert line.bus.read(ID, MODELS[model].registers[name], raw=True) == fresh[name]


def test_restarted_dynamixel_replies_with_torque_off():
    line = line_of("XL430-W250")
    torque_on(line.bus, ID)
    restart_servo(line, servo_of(line))
    assert not line.bus.read(ID, RegisterName.TORQUE_ENABLE, raw=True)


@pytest.mark.parametrize(
    ("name", "text", "raw"),
    [
        ("p_gain", "16", 16),
        ("p_gain", "0x10", 16),
        ("max_temperature_limit", "65C", 65),
        ("max_position_limit", "90deg", 1024),
        ("max_torque", "60%", 600),
        ("protection_time", "500ms", 50),
        ("protection_time", "0.5s", 50),
        ("protection_current", "650mA", 100),
        ("max_voltage_limit", "8.4V", 84),
    ],
)
def test_register_values_are_read_as_raw_or_with_units(name, text, raw):
    assert parse_register_value(find_register(MODELS["STS3215"], name), text) == raw


@pytest.mark.parametrize(
    "text", ["", "x", "1.5", "8V8", "65V", "1e5", "nan", "--3", "\u0663", "9" * 500]
)
def test_invalid_register_value_text_is_refused(text):
    register = find_register(MODELS["STS3215"], "max_temperature_limit")
    line = line_of("STS3215")
    with pytest.raises((InputError, RegisterAccessError)):
        plan_writes(line, servo_of(line), {register: parse_register_value(register, text)})


def test_wrong_register_name_error_suggests_closest_name():
    with pytest.raises(UnknownNameError, match="present_voltage"):
        find_register(MODELS["STS3215"], "present_volt")


def test_eeprom_lock_and_zeroing_register_are_write_protected():
    line = line_of("STS3215")
    for name, raw in (("lock", 0), ("torque_enable", 128)):
        with pytest.raises((RegisterAccessError, BadValueError)):
            write(line, {name: raw})


def test_id_taken_at_new_baud_rate_is_refused_before_writing():
    line = line_of("STS3215")
    other = simulated_servos(line.bus)[1]
    other.memory.put("id", 9)
    other.memory.put("baud_rate", 1)
    for values in ({"id": 9, "baud_rate": 1, "p_gain": 7}, {"id": 9, "baud_rate": 1}):
        with pytest.raises(InputError, match="500000 baud"):
            write(line, values)
    held = simulated_servos(line.bus)[ID]
    assert [held.read(name) for name in ("id", "baud_rate", "p_gain")] == [ID, 0, 32]
    assert line.bus.port.baudrate == 1_000_000


@pytest.mark.parametrize(
    ("model", "name", "raw"),
    [
        ("STS3215", "response_level", 0),
        ("XL430-W250", "status_return_level", 1),
        ("XL430-W250", "secondary_id", 4),
        ("XL430-W250", "protocol_type", 1),
    ],
)
def test_registers_for_replies_and_shared_goals_are_protected(model, name, raw):
    line = line_of(model)
    with pytest.raises(RegisterAccessError):
        write(line, {name: raw})
