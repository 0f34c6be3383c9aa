"""Factory values of servo registers, from the vendors' data sheets.

The values are listed by series, and separately for models that differ. They cover persistent
registers, and the gains of Dynamixel X in RAM.
"""

from __future__ import annotations

from collections.abc import Mapping

from ikservo.registers.control_table import ControlTable
from ikservo.registers.register import Register


def delivered_value(table: type[ControlTable], register: Register) -> int | None:
    """Return the raw factory value of a writable register; None if it is not listed."""
    if not register.is_writable:
        return None
    for name in (table.model_name, *(each.__name__ for each in table.__mro__)):
        if register.name in _DELIVERED.get(name, {}):
            return _DELIVERED[name][register.name]
    return None


# fmt: off
_DELIVERED: Mapping[str, Mapping[str, int]] = {
    "DynamixelX": {
        "id": 1, "baud_rate": 1, "return_delay_time": 250, "drive_mode": 0, "operating_mode": 3,
        "secondary_id": 255, "protocol_type": 2, "homing_offset": 0, "moving_threshold": 10,
        "temperature_limit": 80, "max_voltage_limit": 160, "min_voltage_limit": 95,
        "pwm_limit": 885, "velocity_limit": 350, "max_position_limit": 4095,
        "min_position_limit": 0, "shutdown": 52, "position_d_gain": 0, "position_i_gain": 0,
        "position_p_gain": 800,
    },
    "AX-12A": {
        "id": 1, "baud_rate": 1, "return_delay_time": 250, "cw_angle_limit": 0,
        "ccw_angle_limit": 1023, "temperature_limit": 70, "min_voltage_limit": 60,
        "max_voltage_limit": 140, "max_torque": 1023, "status_return_level": 2, "alarm_led": 36,
        "shutdown": 36,
    },
    "MX-28": {
        "id": 1, "baud_rate": 34, "return_delay_time": 250, "cw_angle_limit": 0,
        "ccw_angle_limit": 4095, "temperature_limit": 80, "min_voltage_limit": 60,
        "max_voltage_limit": 160, "max_torque": 1023, "status_return_level": 2, "alarm_led": 36,
        "shutdown": 36, "multi_turn_offset": 0, "resolution_divider": 1,
    },
    "XL-320": {
        "id": 1, "baud_rate": 3, "return_delay_time": 250, "cw_angle_limit": 0,
        "ccw_angle_limit": 1023, "operating_mode": 2, "temperature_limit": 65,
        "min_voltage_limit": 60, "max_voltage_limit": 90, "max_torque": 1023,
        "status_return_level": 2, "shutdown": 3,
    },
    "FeetechSTS": {
        "id": 1, "baud_rate": 0, "return_delay": 0, "response_level": 1, "min_position_limit": 0,
        "max_position_limit": 4095, "max_temperature_limit": 70, "max_voltage_limit": 140,
        "min_voltage_limit": 40, "max_torque": 1000, "phase": 12, "unload_condition": 37,
        "led_alarm": 37, "p_gain": 32, "d_gain": 32, "i_gain": 0, "min_startup_force": 16,
        "integral_limit": 0, "cw_dead_zone": 1, "ccw_dead_zone": 1, "protection_current": 511,
        "angular_resolution": 1, "homing_offset": 0, "operating_mode": 0, "protective_torque": 20,
        "protection_time": 200, "overload_torque": 80, "speed_p_gain": 10, "over_current_time": 200,
        "speed_i_gain": 10, "moving_threshold": 5, "dts": 10, "speed_unit": 1, "hts": 0,
        "max_speed_limit": 66, "acceleration_limit": 254, "acceleration_multiple": 1,
    },
    "STS3215": {
        "max_voltage_limit": 80,
    },
    "STS3250": {
        "min_startup_force": 5, "max_speed_limit": 110,
    },
    "FeetechSCS": {
        "id": 1, "baud_rate": 0, "return_delay": 0, "response_level": 1, "min_position_limit": 0,
        "max_position_limit": 1023, "max_temperature_limit": 80, "max_voltage_limit": 80,
        "min_voltage_limit": 40, "max_torque": 1000, "phase": 8, "unload_condition": 37,
        "led_alarm": 37, "p_gain": 15, "d_gain": 0, "i_gain": 0, "min_startup_force": 0,
        "cw_dead_zone": 2, "ccw_dead_zone": 2, "protective_torque": 20, "protection_time": 200,
        "overload_torque": 80, "over_current_time": 100, "protection_current": 0,
        "position_offset": 0,
    },
    "SCS0009": {
        "min_position_limit": 20, "max_position_limit": 1003, "max_temperature_limit": 70,
        "cw_dead_zone": 1, "ccw_dead_zone": 1,
    },
    "SCS15": {
        "max_voltage_limit": 250, "min_voltage_limit": 50, "max_torque": 1023,
    },
    "SCS225": {
        "max_voltage_limit": 140,
    },
    "HLS": {
        "secondary_id": 0, "max_voltage_limit": 80, "max_torque": 980, "phase": 0,
        "protection_current": 500, "current_p_gain": 32, "current_i_gain": 32, "speed_p_gain": 32,
        "speed_i_gain": 0,
    },
    "X330": {
        "temperature_limit": 70, "max_voltage_limit": 70, "min_voltage_limit": 35,
        "current_limit": 1750, "velocity_limit": 445, "startup_configuration": 0, "pwm_slope": 140,
        "shutdown": 53, "position_p_gain": 400,
    },
    "XL330-M077": {
        "velocity_limit": 1620, "position_i_gain": 400,
    },
    "XC330-M288": {
        "current_limit": 2352, "velocity_limit": 350, "shutdown": 52, "position_d_gain": 500,
        "position_p_gain": 1100,
    },
    "XC330-M181": {
        "current_limit": 2352, "velocity_limit": 545, "shutdown": 52, "position_d_gain": 500,
        "position_p_gain": 1200,
    },
    "XL430": {
        "temperature_limit": 72, "max_voltage_limit": 140, "min_voltage_limit": 60,
        "velocity_limit": 265, "startup_configuration": 0, "position_d_gain": 4000,
        "position_p_gain": 640,
    },
    "2XL430-W250": {
        "velocity_limit": 250, "position_d_gain": 2000,
    },
    "X430": {
        "current_limit": 1193, "startup_configuration": 0,
    },
    "XM430-W210": {
        "velocity_limit": 330,
    },
    "XH430-W350": {
        "current_limit": 648, "velocity_limit": 130, "position_p_gain": 900,
    },
    "XH430-W210": {
        "current_limit": 648, "velocity_limit": 210, "position_p_gain": 900,
    },
    "XC330T": {
        "max_voltage_limit": 140, "min_voltage_limit": 55, "current_limit": 910,
        "velocity_limit": 320, "pwm_slope": 255, "shutdown": 52, "position_p_gain": 900,
    },
    "XC330-T181": {
        "velocity_limit": 510,
    },
    "XC430": {
        "temperature_limit": 80, "max_voltage_limit": 160, "velocity_limit": 306,
        "position_d_gain": 0, "position_p_gain": 700,
    },
    "XC430-W150": {
        "velocity_limit": 460, "position_p_gain": 460,
    },
    "2XC430-W250": {
        "velocity_limit": 275,
    },
    "X540": {
        "current_limit": 2047, "velocity_limit": 128, "external_port_mode_1": 3,
        "external_port_mode_2": 3, "external_port_mode_3": 3,
    },
    "XM540-W150": {
        "velocity_limit": 230,
    },
    "XH540-W270": {
        "velocity_limit": 167,
    },
    "XH540-W150": {
        "velocity_limit": 300,
    },
}
