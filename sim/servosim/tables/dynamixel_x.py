"""Dynamixel X, protocol 2.0: XL330, XL430, XM430, XM540 (ROBOTIS e-manual, sections 2.2 and 2.3).

Columns that differ between models hold one number a model, in the order of ``_MODELS``;
None marks a register that the model lacks.
"""

from __future__ import annotations

from collections.abc import Iterator

from servosim.tables.register import Area, Family, Register, ServoTable, Sign

__all__ = ["DYNAMIXEL_X"]

_E, _M = Area.EEPROM, Area.RAM
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
_TURNS    = 1_044_479
_GOAL     = 1_048_575

_ROWS: tuple[tuple[int, int, str, str, Area, _Column, _Column, _Column, Sign], ...] = (
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
    ( 20, 4, "homing_offset",          "RW", _E, 0,                       -_TURNS, _TURNS,  _S),
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


def _pick(column: _Column, model: int) -> int | None:
    return column if isinstance(column, int) else column[model]


def _listed(model: int) -> Iterator[Register]:
    for address, size, name, access, area, default, lower, upper, sign in _ROWS:
        at_first = _pick(default, model)
        low, high = _pick(lower, model), _pick(upper, model)
        if at_first is not None and low is not None and high is not None:
            writable = access == "RW"
            yield Register(address, size, name, writable, area, at_first, low, high, sign)


def _indirect(model: int) -> Iterator[Register]:
    blocks = _INDIRECT["XL330" if _MODELS[model].startswith("XL330") else "X"]
    last = blocks[-1][3] + blocks[-1][1] - 1
    for first, count, addresses, data in blocks:
        for k in range(count):
            name = f"indirect_address_{first + k}"
            yield Register(addresses + 2 * k, 2, name, True, Area.RAM, data + k, 64, last)
        for k in range(count):
            name = f"indirect_data_{first + k}"
            yield Register(data + k, 1, name, True, Area.RAM, 0, 0, 255)


def _table(model: int) -> ServoTable:
    return ServoTable(
        model=_MODELS[model],
        family=Family.DYNAMIXEL_X,
        number=_NUMBER[model],
        firmware=_FIRMWARE[model],
        registers=(*_listed(model), *_indirect(model)),
    )


DYNAMIXEL_X = tuple(_table(model) for model in range(len(_MODELS)))
