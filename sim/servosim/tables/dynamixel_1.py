"""Dynamixel with protocol 1.0: AX-12A and MX-28 (ROBOTIS e-manual, control tables)."""

from __future__ import annotations

import math

from servosim.tables.register import Area, Family, Register, ServoTable, Sign

__all__ = ["DYNAMIXEL_1"]

_E, _M = Area.EEPROM, Area.RAM
_U, _S, _B10 = Sign.NONE, Sign.TWOS, Sign.BIT10
_Row = tuple[int, int, str, str, Area, int, int, int, Sign]

# fmt: off
_AX_12A: tuple[_Row, ...] = (
    # address size name           access area default    min     max   sign
    ( 0, 2, "model_number",         "R",  _E,   12,        0,  65535,   _U),
    ( 2, 1, "firmware_version",     "R",  _E,   24,        0,    255,   _U),
    ( 3, 1, "id",                   "RW", _E,    1,        0,    253,   _U),
    ( 4, 1, "baud_rate",            "RW", _E,    1,        0,    254,   _U),
    ( 5, 1, "return_delay_time",    "RW", _E,  250,        0,    254,   _U),
    ( 6, 2, "cw_angle_limit",       "RW", _E,    0,        0,   1023,   _U),
    ( 8, 2, "ccw_angle_limit",      "RW", _E, 1023,        0,   1023,   _U),
    (11, 1, "temperature_limit",    "RW", _E,   70,        0,    100,   _U),
    (12, 1, "min_voltage_limit",    "RW", _E,   60,       50,    160,   _U),
    (13, 1, "max_voltage_limit",    "RW", _E,  140,       50,    160,   _U),
    (14, 2, "max_torque",           "RW", _E, 1023,        0,   1023,   _U),
    (16, 1, "status_return_level",  "RW", _E,    2,        0,      2,   _U),
    (17, 1, "alarm_led",            "RW", _E,   36,        0,    127,   _U),
    (18, 1, "shutdown",             "RW", _E,   36,        0,    127,   _U),
    (24, 1, "torque_enable",        "RW", _M,    0,        0,      1,   _U),
    (25, 1, "led",                  "RW", _M,    0,        0,      1,   _U),
    (26, 1, "cw_compliance_margin", "RW", _M,    1,        0,    255,   _U),
    (27, 1, "ccw_compliance_margin","RW", _M,    1,        0,    255,   _U),
    (28, 1, "cw_compliance_slope",  "RW", _M,   32,        0,    254,   _U),
    (29, 1, "ccw_compliance_slope", "RW", _M,   32,        0,    254,   _U),
    (30, 2, "goal_position",        "RW", _M,    0,        0,   1023,   _U),
    (32, 2, "moving_speed",         "RW", _M,    0,    -1023,   1023, _B10),
    (34, 2, "torque_limit",         "RW", _M, 1023,        0,   1023,   _U),
    (36, 2, "present_position",     "R",  _M,    0,        0,   1023,   _U),
    (38, 2, "present_speed",        "R",  _M,    0,    -1023,   1023, _B10),
    (40, 2, "present_load",         "R",  _M,    0,    -1023,   1023, _B10),
    (42, 1, "present_voltage",      "R",  _M,    0,        0,    255,   _U),
    (43, 1, "present_temperature",  "R",  _M,    0,        0,    255,   _U),
    (44, 1, "registered",           "R",  _M,    0,        0,      1,   _U),
    (46, 1, "moving",               "R",  _M,    0,        0,      1,   _U),
    (47, 1, "lock",                 "RW", _M,    0,        0,      1,   _U),
    (48, 2, "punch",                "RW", _M,   32,       32,   1023,   _U),
)

_MX_28: tuple[_Row, ...] = (
    # address size name           access area default    min     max   sign
    ( 0, 2, "model_number",         "R",  _E,   29,        0,  65535,   _U),
    ( 2, 1, "firmware_version",     "R",  _E,   41,        0,    255,   _U),
    ( 3, 1, "id",                   "RW", _E,    1,        0,    253,   _U),
    ( 4, 1, "baud_rate",            "RW", _E,   34,        0,    254,   _U),
    ( 5, 1, "return_delay_time",    "RW", _E,  250,        0,    254,   _U),
    ( 6, 2, "cw_angle_limit",       "RW", _E,    0,        0,   4095,   _U),
    ( 8, 2, "ccw_angle_limit",      "RW", _E, 4095,        0,   4095,   _U),
    (11, 1, "temperature_limit",    "RW", _E,   80,        0,    100,   _U),
    (12, 1, "min_voltage_limit",    "RW", _E,   60,       50,    160,   _U),
    (13, 1, "max_voltage_limit",    "RW", _E,  160,       50,    160,   _U),
    (14, 2, "max_torque",           "RW", _E, 1023,        0,   1023,   _U),
    (16, 1, "status_return_level",  "RW", _E,    2,        0,      2,   _U),
    (17, 1, "alarm_led",            "RW", _E,   36,        0,    127,   _U),
    (18, 1, "shutdown",             "RW", _E,   36,        0,    127,   _U),
    (20, 2, "multi_turn_offset",    "RW", _E,    0,   -24576,  24576,   _S),
    (22, 1, "resolution_divider",   "RW", _E,    1,        1,      4,   _U),
    (24, 1, "torque_enable",        "RW", _M,    0,        0,      1,   _U),
    (25, 1, "led",                  "RW", _M,    0,        0,      1,   _U),
    (26, 1, "d_gain",               "RW", _M,    0,        0,    254,   _U),
    (27, 1, "i_gain",               "RW", _M,    0,        0,    254,   _U),
    (28, 1, "p_gain",               "RW", _M,   32,        0,    254,   _U),
    (30, 2, "goal_position",        "RW", _M,    0,   -28672,  28672,   _S),
    (32, 2, "moving_speed",         "RW", _M,    0,    -1023,   1023, _B10),
    (34, 2, "torque_limit",         "RW", _M, 1023,        0,   1023,   _U),
    (36, 2, "present_position",     "R",  _M,    0,   -32768,  32767,   _S),
    (38, 2, "present_speed",        "R",  _M,    0,    -1023,   1023, _B10),
    (40, 2, "present_load",         "R",  _M,    0,    -1023,   1023, _B10),
    (42, 1, "present_voltage",      "R",  _M,    0,        0,    255,   _U),
    (43, 1, "present_temperature",  "R",  _M,    0,        0,    255,   _U),
    (44, 1, "registered",           "R",  _M,    0,        0,      1,   _U),
    (46, 1, "moving",               "R",  _M,    0,        0,      1,   _U),
    (47, 1, "lock",                 "RW", _M,    0,        0,      1,   _U),
    (48, 2, "punch",                "RW", _M,    0,        0,   1023,   _U),
    (50, 2, "realtime_tick",        "R",  _M,    0,        0,  32767,   _U),
    (73, 1, "goal_acceleration",    "RW", _M,    0,        0,    254,   _U),
)
# fmt: on


def _register(row: _Row) -> Register:
    address, size, name, access, area, default, lower, upper, sign = row
    return Register(address, size, name, access == "RW", area, default, lower, upper, sign)


DYNAMIXEL_1 = (
    ServoTable(
        model="AX-12A",
        family=Family.DYNAMIXEL_1,
        number=12,
        firmware=24,
        registers=tuple(_register(row) for row in _AX_12A),
        ticks_per_turn=1024 * 360.0 / 300.0,
        middle_tick=512,
        travel_rad=math.radians(300.0),
    ),
    ServoTable(
        model="MX-28",
        family=Family.DYNAMIXEL_1,
        number=29,
        firmware=41,
        registers=tuple(_register(row) for row in _MX_28),
    ),
)
