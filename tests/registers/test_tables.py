"""The control tables: no overlaps, every role filled, facts of the data sheets."""

from __future__ import annotations

from itertools import pairwise
from math import pi, radians

import pytest

from ikservo.errors import UnknownNameError
from ikservo.registers import (
    AX12A,
    MODELS,
    MX28,
    SCS0009,
    SCS15,
    STS3215,
    XL330M288,
    XL430W250,
    XM430W350,
    Access,
    Alarm,
    Area,
    ControlTable,
    Family,
    RegisterName,
    control_table,
    control_table_for_number,
)

every_table = pytest.mark.parametrize("table", MODELS.values(), ids=MODELS)


@every_table
def test_registers_do_not_overlap(table):
    for lower, upper in pairwise(table.registers.values()):
        assert lower.end <= upper.address, f"{lower} runs into {upper}"


@every_table
def test_every_register_role_is_mapped_or_marked_missing(table):
    for role in set(RegisterName) - set(table.missing):
        assert table.find(role) in table.registers.values(), role
    for role in table.missing:
        with pytest.raises(UnknownNameError, match=f"{table.model_name} register"):
            table.find(role)


def test_register_roles_are_declared_for_type_checkers():
    declared = {
        n for n, kind in ControlTable.__annotations__.items() if kind == "ClassVar[Register]"
    }
    assert declared == set(RegisterName)


@every_table
def test_register_is_attribute_of_its_table(table):
    for name, register in table.registers.items():
        assert getattr(table, name) is register


@every_table
def test_writable_range_fits_register_bytes(table):
    for register in table.registers.values():
        lower, upper = register.range
        least, most = register.codec.span(register.size)
        assert least <= lower <= upper <= most, register


@every_table
def test_measured_registers_are_read_only(table):
    measured = [r for name, r in table.registers.items() if name.startswith("present_")]
    assert {register.access for register in measured} == {Access.RO}


@every_table
def test_ram_registers_follow_eeprom_registers(table):
    own = STS3215.moving_threshold.address if table.family is Family.FEETECH_STS else 1 << 16
    eeprom = [r.end for r in table.registers.values() if r.area is Area.EEPROM and r.address < own]
    ram = [r.address for r in table.registers.values() if r.area is Area.RAM]
    assert max(eeprom) <= min(ram)


# The makers' numbers, copied a second time.
# fmt: off
NUMBERS = {
    "STS3215": 777, "STS3250": 2825, "STS3235": 9 + (8 << 8), "HLS3606M": 10 + (10 << 8),
    "SCS0009": 0x504, "SCS15": 0x50F, "SCS225": (9 << 8) + 35,
    "XL330-M288": 1200, "XL330-M077": 1190,
    "XC330-M288": 1240, "XC330-M181": 1230, "XC330-T288": 1220, "XC330-T181": 1210,
    "XL430-W250": 1060, "2XL430-W250": 1090,
    "XC430-W240": 1080, "XC430-W150": 1070, "2XC430-W250": 1160,
    "XM430-W350": 1020, "XM430-W210": 1030, "XH430-W350": 1000, "XH430-W210": 1010,
    "XM540-W270": 1120, "XM540-W150": 1130, "XH540-W270": 1100, "XH540-W150": 1110,
    "AX-12A": 12, "MX-28": 29, "XL-320": 350,
}
# fmt: on


@pytest.mark.parametrize("model", NUMBERS)
def test_servo_model_number_selects_register_table(model):
    table = MODELS[model]
    assert control_table_for_number(table.family, NUMBERS[model]) is table


def test_servo_model_numbers_are_unique_within_family():
    numbers = [(table.family, table.number) for table in MODELS.values()]
    assert len(set(numbers)) == len(numbers)


def test_unknown_servo_model_number_has_no_register_table():
    assert control_table_for_number(Family.DYNAMIXEL_2, 4242) is None


def test_register_table_is_found_by_model_name():
    assert control_table("STS3215") is STS3215


def test_unknown_model_name_suggests_closest():
    with pytest.raises(UnknownNameError, match="XL430-W250"):
        control_table("XL430-W25")


def test_register_role_finds_register_with_any_vendor_name():
    assert STS3215.find(RegisterName.PRESENT_VOLTAGE) is STS3215.present_voltage
    assert XL430W250.find(RegisterName.PRESENT_VOLTAGE) is XL430W250.present_input_voltage


def test_register_of_another_model_is_mapped_by_its_role():
    assert XL330M288.find(XL430W250.max_voltage_limit) is XL330M288.max_voltage_limit


def test_dual_shaft_servo_models_lack_two_registers():
    lacks = {"startup_configuration", "backup_ready"}
    assert lacks <= XL430W250.registers.keys()
    for model in ("2XL430-W250", "2XC430-W250"):
        assert MODELS[model].registers.keys() == XL430W250.registers.keys() - lacks


def test_register_role_missing_in_servo_model_is_refused():
    with pytest.raises(UnknownNameError, match="HLS3606M register named 'return_delay'"):
        MODELS["HLS3606M"].find(RegisterName.RETURN_DELAY)


def test_error_names_register_missing_in_model():
    with pytest.raises(UnknownNameError, match="XL430-W250 register named 'goal_current'"):
        XL430W250.find(XL330M288.goal_current)


@pytest.mark.parametrize(
    ("register", "raw", "value"),
    [
        (STS3215.present_position, 1024, pi / 2),
        (STS3215.present_voltage, 123, 12.3),
        (STS3215.present_current, 100, 0.65),
        (STS3215.acceleration, 254, 25400 * 2 * pi / 4096),
        (STS3215.present_temperature, 40, 40.0),
        (XL430W250.present_load, 500, 0.5),
        (XL430W250.profile_velocity, 100, 22.9 * 2 * pi / 60),
        (XL430W250.goal_pwm, 885, 1.0),
        (XL430W250.bus_watchdog, 5, 0.1),
        (XM430W350.present_current, 1000, 2.69),
        (XL330M288.present_current, 1000, 1.0),
        (MODELS["XC330-T288"].registers["pwm_slope"], 200, 791.0),
        (XL430W250.return_delay_time, 250, 0.0005),
        (SCS0009.present_position, 512, radians(150)),
        (SCS15.present_position, 512, radians(100)),
        (MODELS["HLS3606M"].goal_speed, 8, 400 * 2 * pi / 4096),
        (MODELS["HLS3606M"].registers["goal_torque"], -500, -3.25),
        (AX12A.present_position, 512, radians(150)),
        (AX12A.moving_speed, 1023, 0.111 * 1023 * 2 * pi / 60),
        (MX28.present_position, 1024, pi / 2),
        (MODELS["XL-320"].present_position, 1024, radians(300)),
        (MX28.goal_acceleration, 10, radians(85.83)),
    ],
)
class TestUnits:
    """One count equals the value in the data sheet, in both directions."""

    def test_register_converts_raw_to_value(self, register, raw, value):
        assert register.to_value(raw) == pytest.approx(value)

    def test_register_converts_value_to_raw(self, register, raw, value):
        assert register.to_raw(value) == raw


def test_register_without_unit_returns_integer():
    assert isinstance(STS3215.p_gain.to_value(32), int)


def test_alarm_bits_decode_to_named_alarms():
    assert STS3215.decode_alarms(0b100001) == {Alarm.VOLTAGE, Alarm.OVERLOAD}
    assert XL430W250.decode_alarms(0b010000) == {Alarm.SHOCK}
    assert MODELS["XL-320"].decode_alarms(0b101) == {Alarm.OVERLOAD, Alarm.VOLTAGE}


def test_unnamed_alarm_bit_is_decoded_as_unknown_alarm():
    assert STS3215.decode_alarms(0b1000_0000) == {Alarm.UNKNOWN}
