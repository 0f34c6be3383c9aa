"""The control tables, compared with other published ones: names, addresses and sizes.

``published_tables.toml`` has two sources or more for each family. Differences from the maker's
present data sheet, which the tables follow, are listed here; there must be no others.
"""

import re
import tomllib
from pathlib import Path

import pytest

from ikservo.registers import MODELS, Family

FILE = Path(__file__).parent / "published_tables.toml"
CASES = [
    (table["source"], model, re.findall(r"(\d+)/(\d+)\s(\w+)", table["registers"]))
    for table in tomllib.loads(FILE.read_text("utf-8"))["table"]
    for model in table["models"]
]

# The same register by another name.
ALIASES = {
    "secondary_shadow_id": "secondary_id", "protocol_version": "protocol_type",
    "control_mode": "operating_mode", "registered": "registered_instruction",
    "firmware_major_version": "firmware_major", "firmware_minor_version": "firmware_minor",
    "wb_maj_ver": "firmware_major", "wb_min_ver": "firmware_minor",
    "version_major": "firmware_major", "version_minor": "firmware_minor",
    "model": "model_number", "return_delay_time": "return_delay",
    "delay_time_return": "return_delay", "response_status_level": "response_level",
    "level_return": "response_level", "return_level": "response_level",
    "min_angle_limit": "min_position_limit", "max_angle_limit": "max_position_limit",
    "max_temp_limit": "max_temperature_limit", "limit_temperature": "max_temperature_limit",
    "max_input_volt": "max_voltage_limit", "max_limit_voltage": "max_voltage_limit",
    "min_input_volt": "min_voltage_limit", "min_limit_voltage": "min_voltage_limit",
    "max_torque_limit": "max_torque", "setting_byte": "phase",
    "unloading_condition": "unload_condition", "unload_cond": "unload_condition",
    "led_alarm_condition": "led_alarm", "alarm_led": "led_alarm", "alarm_shutdown": "led_alarm",
    "p_coefficient": "p_gain", "d_coefficient": "d_gain", "i_coefficient": "i_gain",
    "p_coef": "p_gain", "d_coef": "d_gain", "i_coef": "i_gain",
    "compliance_p": "p_gain", "compliance_d": "d_gain", "compliance_i": "i_gain",
    "minimum_startup_force": "min_startup_force", "punch": "min_startup_force",
    "cw_dead": "cw_dead_zone", "ccw_dead": "ccw_dead_zone",
    "overload_current": "protection_current", "ang_resolution": "angular_resolution",
    "ofs": "homing_offset", "mode": "operating_mode", "acc": "acceleration",
    "protect_torque": "protective_torque", "protect_time": "protection_time",
    "ovload_torque": "overload_torque",
    "velocity_closed_loop_p_proportional_coefficient": "speed_p_gain",
    "velocity_closed_loop_i_integral_coefficient": "speed_i_gain",
    "over_current_protection_time": "over_current_time",
    "goal_velocity": "goal_speed", "present_velocity": "present_speed",
    "running_time": "goal_time", "sync_write_flag": "async_write",
    "async_write_flag": "async_write", "present_status": "status",
    "moving_velocity_threshold": "moving_threshold", "velocity_unit_factor": "speed_unit",
    "maximum_velocity_limit": "max_speed_limit", "maximum_acceleration": "acceleration_limit",
    "acceleration_multiplier": "acceleration_multiple",
}  # fmt: skip

# Rows of a source that the maker's sheet of the model does not have.
NOT_IN_THE_SHEET = {
    "acceleration_limit",  # X servos: of PRO servos
    "goal_position_2",  # of STS servos: their target_position, 67, is another
    "acceleration", "pwm_maximum_step", "moving_velocity_threshold_50", "dts",  # of SCS0009
    "minimum_velocity_limit_50", "maximum_velocity_limit_50", "acceleration_2",
}  # fmt: skip
OF_SOME_MODELS = {
    ("2XL430-W250", "startup_configuration"), ("2XL430-W250", "backup_ready"),
    ("2XC430-W250", "startup_configuration"), ("2XC430-W250", "backup_ready"),
    ("SCS225", "compliance_i"),
}  # fmt: skip
# What the sheet has changed: (model or family, name) to what it was, and is.
CHANGED = {
    # one byte since the integral limit has the one behind it
    (Family.FEETECH_STS, "minimum_startup_force"): "min_startup_force",
    (Family.FEETECH_STS, "startup_force"): "min_startup_force",
    ("XL-320", "torque_limit"): "torque_limit",  # 35; one source has 34, the other two 35
    ("SCS225", "goal_time"): "goal_pwm",  # another register at this address
    (Family.FEETECH_SCS, "alarm_led"): "unload_condition",  # former names of the two
}


@pytest.mark.parametrize(("source", "model", "rows"), CASES, ids=[f"{m}, {s}" for s, m, _ in CASES])
def test_register_tables_match_published_tables(source, model, rows):
    table = MODELS[model]
    assert len(rows) > 25
    for address, size, name in rows:
        changed = CHANGED.get((model, name)) or CHANGED.get((table.family, name))
        if changed:
            assert changed in table.registers
            continue
        own = name if name in table.registers else ALIASES.get(name, name)
        if own not in table.registers:
            assert name in NOT_IN_THE_SHEET or (model, name) in OF_SOME_MODELS, name
            continue
        register = table.registers[own]
        assert (register.address, register.size) == (int(address), int(size)), name


def test_register_tables_have_two_published_sources_per_family():
    for family in Family:
        found = {source for source, model, _ in CASES if MODELS[model].family is family}
        assert len(found) >= 2, family


@pytest.mark.parametrize("model", ["STS3215", "SCS0009", "XL330-M288", "XM430-W350", "AX-12A",
                                   "MX-28", "XL-320"])  # fmt: skip
def test_only_four_registers_lack_a_published_source(model):
    published = {
        (int(address), int(size)) for _, each, rows in CASES if each == model
        for address, size, _ in rows
    }  # fmt: skip
    alone = {n for n, r in MODELS[model].registers.items() if (r.address, r.size) not in published}
    assert alone <= {"end", "min_startup_force", "integral_limit", "target_position"}
