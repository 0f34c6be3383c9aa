"""Control tables of Dynamixel AX, MX and X servos (ROBOTIS e-manual).

Columns that differ between models hold one number a model, in the order of ``_MODELS``;
None marks a register that the model lacks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from servosim.register import ServoTable, Sign, SimulatedArea, SimulatedFamily, SimulatedRegister

__all__ = ["DYNAMIXEL_1", "DYNAMIXEL_X"]


_EEPROM_1, _RAM_1 = SimulatedArea.EEPROM, SimulatedArea.RAM
_U1, _S1, _B10 = Sign.NONE, Sign.TWOS, Sign.BIT10
_Row = tuple[int, int, str, str, SimulatedArea, int, int, int, Sign]

# fmt: off
_AX_12A: tuple[_Row, ...] = (
    # address size name           access area default    min     max   sign
    ( 0, 2, "model_number",         "R",  _EEPROM_1,   12,        0,  65535,   _U1),
    ( 2, 1, "firmware_version",     "R",  _EEPROM_1,   24,        0,    255,   _U1),
    ( 3, 1, "id",                   "RW", _EEPROM_1,    1,        0,    253,   _U1),
    ( 4, 1, "baud_rate",            "RW", _EEPROM_1,    1,        0,    254,   _U1),
    ( 5, 1, "return_delay_time",    "RW", _EEPROM_1,  250,        0,    254,   _U1),
    ( 6, 2, "cw_angle_limit",       "RW", _EEPROM_1,    0,        0,   1023,   _U1),
    ( 8, 2, "ccw_angle_limit",      "RW", _EEPROM_1, 1023,        0,   1023,   _U1),
    (11, 1, "temperature_limit",    "RW", _EEPROM_1,   70,        0,    100,   _U1),
    (12, 1, "min_voltage_limit",    "RW", _EEPROM_1,   60,       50,    160,   _U1),
    (13, 1, "max_voltage_limit",    "RW", _EEPROM_1,  140,       50,    160,   _U1),
    (14, 2, "max_torque",           "RW", _EEPROM_1, 1023,        0,   1023,   _U1),
    (16, 1, "status_return_level",  "RW", _EEPROM_1,    2,        0,      2,   _U1),
    (17, 1, "alarm_led",            "RW", _EEPROM_1,   36,        0,    127,   _U1),
    (18, 1, "shutdown",             "RW", _EEPROM_1,   36,        0,    127,   _U1),
    (24, 1, "torque_enable",        "RW", _RAM_1,    0,        0,      1,   _U1),
    (25, 1, "led",                  "RW", _RAM_1,    0,        0,      1,   _U1),
    (26, 1, "cw_compliance_margin", "RW", _RAM_1,    1,        0,    255,   _U1),
    (27, 1, "ccw_compliance_margin","RW", _RAM_1,    1,        0,    255,   _U1),
    (28, 1, "cw_compliance_slope",  "RW", _RAM_1,   32,        0,    254,   _U1),
    (29, 1, "ccw_compliance_slope", "RW", _RAM_1,   32,        0,    254,   _U1),
    (30, 2, "goal_position",        "RW", _RAM_1,    0,        0,   1023,   _U1),
    (32, 2, "moving_speed",         "RW", _RAM_1,    0,    -1023,   1023, _B10),
    (34, 2, "torque_limit",         "RW", _RAM_1, 1023,        0,   1023,   _U1),
    (36, 2, "present_position",     "R",  _RAM_1,    0,        0,   1023,   _U1),
    (38, 2, "present_speed",        "R",  _RAM_1,    0,    -1023,   1023, _B10),
    (40, 2, "present_load",         "R",  _RAM_1,    0,    -1023,   1023, _B10),
    (42, 1, "present_voltage",      "R",  _RAM_1,    0,        0,    255,   _U1),
    (43, 1, "present_temperature",  "R",  _RAM_1,    0,        0,    255,   _U1),
    (44, 1, "registered",           "R",  _RAM_1,    0,        0,      1,   _U1),
    (46, 1, "moving",               "R",  _RAM_1,    0,        0,      1,   _U1),
    (47, 1, "lock",                 "RW", _RAM_1,    0,        0,      1,   _U1),
    (48, 2, "punch",                "RW", _RAM_1,   32,       32,   1023,   _U1),
)

_MX_28: tuple[_Row, ...] = (
    # address size name           access area default    min     max   sign
    ( 0, 2, "model_number",         "R",  _EEPROM_1,   29,        0,  65535,   _U1),
    ( 2, 1, "firmware_version",     "R",  _EEPROM_1,   41,        0,    255,   _U1),
    ( 3, 1, "id",                   "RW", _EEPROM_1,    1,        0,    253,   _U1),
    ( 4, 1, "baud_rate",            "RW", _EEPROM_1,   34,        0,    254,   _U1),
    ( 5, 1, "return_delay_time",    "RW", _EEPROM_1,  250,        0,    254,   _U1),
    ( 6, 2, "cw_angle_limit",       "RW", _EEPROM_1,    0,        0,   4095,   _U1),
    ( 8, 2, "ccw_angle_limit",      "RW", _EEPROM_1, 4095,        0,   4095,   _U1),
    (11, 1, "temperature_limit",    "RW", _EEPROM_1,   80,        0,    100,   _U1),
    (12, 1, "min_voltage_limit",    "RW", _EEPROM_1,   60,       50,    160,   _U1),
    (13, 1, "max_voltage_limit",    "RW", _EEPROM_1,  160,       50,    160,   _U1),
    (14, 2, "max_torque",           "RW", _EEPROM_1, 1023,        0,   1023,   _U1),
    (16, 1, "status_return_level",  "RW", _EEPROM_1,    2,        0,      2,   _U1),
    (17, 1, "alarm_led",            "RW", _EEPROM_1,   36,        0,    127,   _U1),
    (18, 1, "shutdown",             "RW", _EEPROM_1,   36,        0,    127,   _U1),
    (20, 2, "multi_turn_offset",    "RW", _EEPROM_1,    0,   -24576,  24576,   _S1),
    (22, 1, "resolution_divider",   "RW", _EEPROM_1,    1,        1,      4,   _U1),
    (24, 1, "torque_enable",        "RW", _RAM_1,    0,        0,      1,   _U1),
    (25, 1, "led",                  "RW", _RAM_1,    0,        0,      1,   _U1),
    (26, 1, "d_gain",               "RW", _RAM_1,    0,        0,    254,   _U1),
    (27, 1, "i_gain",               "RW", _RAM_1,    0,        0,    254,   _U1),
    (28, 1, "p_gain",               "RW", _RAM_1,   32,        0,    254,   _U1),
    (30, 2, "goal_position",        "RW", _RAM_1,    0,   -28672,  28672,   _S1),
    (32, 2, "moving_speed",         "RW", _RAM_1,    0,    -1023,   1023, _B10),
    (34, 2, "torque_limit",         "RW", _RAM_1, 1023,        0,   1023,   _U1),
    (36, 2, "present_position",     "R",  _RAM_1,    0,   -32768,  32767,   _S1),
    (38, 2, "present_speed",        "R",  _RAM_1,    0,    -1023,   1023, _B10),
    (40, 2, "present_load",         "R",  _RAM_1,    0,    -1023,   1023, _B10),
    (42, 1, "present_voltage",      "R",  _RAM_1,    0,        0,    255,   _U1),
    (43, 1, "present_temperature",  "R",  _RAM_1,    0,        0,    255,   _U1),
    (44, 1, "registered",           "R",  _RAM_1,    0,        0,      1,   _U1),
    (46, 1, "moving",               "R",  _RAM_1,    0,        0,      1,   _U1),
    (47, 1, "lock",                 "RW", _RAM_1,    0,        0,      1,   _U1),
    (48, 2, "punch",                "RW", _RAM_1,    0,        0,   1023,   _U1),
    (50, 2, "realtime_tick",        "R",  _RAM_1,    0,        0,  32767,   _U1),
    (73, 1, "goal_acceleration",    "RW", _RAM_1,    0,        0,    254,   _U1),
)
# fmt: on


def _make_register(row: _Row) -> SimulatedRegister:
    address, size, name, access, area, default, lower, upper, sign = row
    return SimulatedRegister(address, size, name, access == "RW", area, default, lower, upper, sign)


DYNAMIXEL_1 = (
    ServoTable(
        model="AX-12A",
        family=SimulatedFamily.DYNAMIXEL_1,
        number=12,
        firmware=24,
        registers=tuple(_make_register(row) for row in _AX_12A),
        ticks_per_turn=1024 * 360.0 / 300.0,
        middle_tick=512,
        travel_rad=math.radians(300.0),
    ),
    ServoTable(
        model="MX-28",
        family=SimulatedFamily.DYNAMIXEL_1,
        number=29,
        firmware=41,
        registers=tuple(_make_register(row) for row in _MX_28),
    ),
)


_E, _M = SimulatedArea.EEPROM, SimulatedArea.RAM
_U, _S = Sign.NONE, Sign.TWOS
_Column = int | tuple[int | None, ...]

# fmt: off
_MODELS = ("XL330-M288", "XL330-M077", "XL430-W250", "XM430-W350", "XM540-W270")
_NUMBER   = (1200, 1190, 1060, 1020, 1120)
_FIRMWARE = (  52,   52,   46,   46,   46)

_BAUD     = (   6,    6,    7,    7,    7)
_P_MIN    = (   2,    2,    1,    1,    1)
_P_MAX    = (  22,   22,    2,    2,    2)
_V_MIN    = (  31,   31,   60,   95,   95)
_V_MAX    = (  70,   70,  140,  160,  160)
_AMPERES  = (1750, 1750, None, 1193, 2047)
_SPEED    = (2047, 2047, 1023, 1023, 1023)
_VELOCITY_I = (1600, 400, 1000, 1920, 1920)
_VELOCITY_P = ( 180,  40,  100,  100,  100)
_POSITION_I = (   0, 400,    0,    0,    0)
_X330     = ( 140,  140, None, None, None)
_X540     = (None, None, None, None,    3)
_X540_DATA = (None, None, None, None, 0)
_MAX_TURNS    = 1_044_479
_GOAL     = 1_048_575

_ROWS: tuple[tuple[int, int, str, str, SimulatedArea, _Column, _Column, _Column, Sign], ...] = (
    # adr size name                     access area default                  min      max      sign
    (  0, 2, "model_number",           "R",  _E, _NUMBER,                 0,       65535,   _U),
    (  2, 4, "model_information",      "R",  _E, 0,                       0,       0,       _U),
    (  6, 1, "firmware_version",       "R",  _E, _FIRMWARE,               0,       255,     _U),
    (  7, 1, "id",                     "RW", _E, 1,                       0,       252,     _U),
    (  8, 1, "baud_rate",              "RW", _E, 1,                       0,       _BAUD,   _U),
    (  9, 1, "return_delay_time",      "RW", _E, 250,                     0,       254,     _U),
    ( 10, 1, "drive_mode",             "RW", _E, 0,                       0,       13,      _U),
    ( 11, 1, "operating_mode",         "RW", _E, 3,                       0,       16,      _U),
    ( 12, 1, "secondary_id",           "RW", _E, 255,                     0,       255,     _U),
    ( 13, 1, "protocol_type",          "RW", _E, 2,                       _P_MIN,  _P_MAX,  _U),
    ( 20, 4, "homing_offset",          "RW", _E, 0,                 -_MAX_TURNS, _MAX_TURNS,  _S),
    ( 24, 4, "moving_threshold",       "RW", _E, 10,                      0,       1023,    _U),
    ( 31, 1, "temperature_limit",      "RW", _E, (70, 70, 72, 80, 80),    0,       100,     _U),
    ( 32, 2, "max_voltage_limit",      "RW", _E, _V_MAX,                  _V_MIN,  _V_MAX,  _U),
    ( 34, 2, "min_voltage_limit",      "RW", _E, (35, 35, 60, 95, 95),    _V_MIN,  _V_MAX,  _U),
    ( 36, 2, "pwm_limit",              "RW", _E, 885,                     0,       885,     _U),
    ( 38, 2, "current_limit",          "RW", _E, _AMPERES,                0,       _AMPERES,_U),
    ( 44, 4, "velocity_limit",         "RW", _E, (445, 1620, 265, 350, 128), 0,       _SPEED,  _U),
    ( 48, 4, "max_position_limit",     "RW", _E, 4095,                    0,       4095,    _U),
    ( 52, 4, "min_position_limit",     "RW", _E, 0,                       0,       4095,    _U),
    ( 56, 1, "external_port_mode_1",   "RW", _E, _X540,                   0,       3,       _U),
    ( 57, 1, "external_port_mode_2",   "RW", _E, _X540,                   0,       3,       _U),
    ( 58, 1, "external_port_mode_3",   "RW", _E, _X540,                   0,       3,       _U),
    ( 60, 1, "startup_configuration",  "RW", _E, 0,                       0,       3,       _U),
    ( 62, 1, "pwm_slope",              "RW", _E, _X330,                   1,       255,     _U),
    ( 63, 1, "shutdown",               "RW", _E, (53, 53, 52, 52, 52),    0,       63,      _U),
    ( 64, 1, "torque_enable",          "RW", _M, 0,                       0,       1,       _U),
    ( 65, 1, "led",                    "RW", _M, 0,                       0,       1,       _U),
    ( 68, 1, "status_return_level",    "RW", _M, 2,                       0,       2,       _U),
    ( 69, 1, "registered_instruction", "R",  _M, 0,                       0,       1,       _U),
    ( 70, 1, "hardware_error_status",  "R",  _M, 0,                       0,       255,     _U),
    ( 76, 2, "velocity_i_gain",        "RW", _M, _VELOCITY_I,             0,       16383,   _U),
    ( 78, 2, "velocity_p_gain",        "RW", _M, _VELOCITY_P,             0,       16383,   _U),
    ( 80, 2, "position_d_gain",        "RW", _M, ( 0, 0, 4000, 0, 0),     0,       16383,   _U),
    ( 82, 2, "position_i_gain",        "RW", _M, _POSITION_I,             0,       16383,   _U),
    ( 84, 2, "position_p_gain",        "RW", _M, ( 400, 400, 640, 800, 800), 0,       16383,   _U),
    ( 88, 2, "feedforward_2nd_gain",   "RW", _M, 0,                       0,       16383,   _U),
    ( 90, 2, "feedforward_1st_gain",   "RW", _M, 0,                       0,       16383,   _U),
    ( 98, 1, "bus_watchdog",           "RW", _M, 0,                       0,       127,     _S),
    (100, 2, "goal_pwm",               "RW", _M, 885,                     -885,    885,     _S),
    (102, 2, "goal_current",           "RW", _M, _AMPERES,                -2047,   2047,    _S),
    (104, 4, "goal_velocity",          "RW", _M, 0,                       -2047,   2047,    _S),
    (108, 4, "profile_acceleration",   "RW", _M, 0,                       0,       32767,   _U),
    (112, 4, "profile_velocity",       "RW", _M, 0,                       0,       32767,   _U),
    (116, 4, "goal_position",          "RW", _M, 0,                       -_GOAL,  _GOAL,   _S),
    (120, 2, "realtime_tick",          "R",  _M, 0,                       0,       32767,   _U),
    (122, 1, "moving",                 "R",  _M, 0,                       0,       1,       _U),
    (123, 1, "moving_status",          "R",  _M, 0,                       0,       255,     _U),
    (124, 2, "present_pwm",            "R",  _M, 0,                       -885,    885,     _S),
    (126, 2, "present_current",        "R",  _M, (0, 0, None, 0, 0),      -32768,  32767,   _S),
    (126, 2, "present_load",           "R",  _M, (None, None, 0, None, None), -1000,   1000,    _S),
    (128, 4, "present_velocity",       "R",  _M, 0,                       -32768,  32767,   _S),
    (132, 4, "present_position",       "R",  _M, 0,                       -_GOAL,  _GOAL,   _S),
    (136, 4, "velocity_trajectory",    "R",  _M, 0,                       -32768,  32767,   _S),
    (140, 4, "position_trajectory",    "R",  _M, 0,                       -_GOAL,  _GOAL,   _S),
    (144, 2, "present_input_voltage",  "R",  _M, 0,                       0,       255,     _U),
    (146, 1, "present_temperature",    "R",  _M, 0,                       0,       255,     _U),
    (147, 1, "backup_ready",           "R",  _M, 0,                       0,       1,       _U),
    (152, 2, "external_port_data_1",   "RW", _M, _X540_DATA,              0,       4095,    _U),
    (154, 2, "external_port_data_2",   "RW", _M, _X540_DATA,              0,       4095,    _U),
    (156, 2, "external_port_data_3",   "RW", _M, _X540_DATA,              0,       4095,    _U),
)

# Indirect registers: (number of the first, how many, first address of the addresses, of the data)
_INDIRECT = {
    "XL330": ((1, 20, 168, 208),),
    "X":     ((1, 28, 168, 224), (29, 28, 578, 634)),
}
# fmt: on


def _model_value(column: _Column, model: int) -> int | None:
    return column if isinstance(column, int) else column[model]


def _listed_registers(model: int) -> Iterator[SimulatedRegister]:
    for address, size, name, access, area, default, lower, upper, sign in _ROWS:
        at_first = _model_value(default, model)
        low, high = _model_value(lower, model), _model_value(upper, model)
        if at_first is not None and low is not None and high is not None:
            writable = access == "RW"
            yield SimulatedRegister(address, size, name, writable, area, at_first, low, high, sign)


def _indirect_registers(model: int) -> Iterator[SimulatedRegister]:
    blocks = _INDIRECT["XL330" if _MODELS[model].startswith("XL330") else "X"]
    last = blocks[-1][3] + blocks[-1][1] - 1
    for first, count, addresses, data in blocks:
        for k in range(count):
            name = f"indirect_address_{first + k}"
            yield SimulatedRegister(
                addresses + 2 * k, 2, name, True, SimulatedArea.RAM, data + k, 64, last
            )
        for k in range(count):
            name = f"indirect_data_{first + k}"
            yield SimulatedRegister(data + k, 1, name, True, SimulatedArea.RAM, 0, 0, 255)


def _make_table(model: int) -> ServoTable:
    return ServoTable(
        model=_MODELS[model],
        family=SimulatedFamily.DYNAMIXEL_X,
        number=_NUMBER[model],
        firmware=_FIRMWARE[model],
        registers=(*_listed_registers(model), *_indirect_registers(model)),
    )


DYNAMIXEL_X = tuple(_make_table(model) for model in range(len(_MODELS)))
