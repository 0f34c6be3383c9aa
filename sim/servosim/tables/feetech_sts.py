"""Feetech STS, little-endian, sign-magnitude: STS3215 and STS3250 (Feetech memory table, STS).

Columns that differ between models hold one number a model, in the order of ``_MODELS``.
"""

from __future__ import annotations

from servosim.tables.register import Area, Family, Register, ServoTable, Sign

__all__ = ["FEETECH_STS"]

_E, _M = Area.EEPROM, Area.RAM
_U, _B10, _B11, _B15 = Sign.NONE, Sign.BIT10, Sign.BIT11, Sign.BIT15
_Column = int | tuple[int, ...]

# fmt: off
_MODELS = ("STS3215", "STS3250")
_NUMBER = (777, 2825)

_ROWS: tuple[tuple[int, int, str, str, Area, _Column, int, int, Sign], ...] = (
    # address size name            access area  default     min     max   sign
    ( 0, 1, "firmware_major",        "R",  _E, 3,            0,    255,   _U),
    ( 1, 1, "firmware_minor",        "R",  _E, 10,           0,    255,   _U),
    ( 2, 1, "end",                   "R",  _E, 0,            0,      1,   _U),
    ( 3, 2, "model_number",          "R",  _E, _NUMBER,      0,  65535,   _U),
    ( 5, 1, "id",                    "RW", _E, 1,            0,    253,   _U),
    ( 6, 1, "baud_rate",             "RW", _E, 0,            0,     11,   _U),
    ( 7, 1, "return_delay",          "RW", _E, 0,            0,    254,   _U),
    ( 8, 1, "response_level",        "RW", _E, 1,            0,      1,   _U),
    ( 9, 2, "min_position_limit",    "RW", _E, 0,            0,   4094,   _U),
    (11, 2, "max_position_limit",    "RW", _E, 4095,         0,   4095,   _U),
    (13, 1, "max_temperature_limit", "RW", _E, 70,           0,    100,   _U),
    (14, 1, "max_voltage_limit",     "RW", _E, (80, 140),       0,    254,   _U),
    (15, 1, "min_voltage_limit",     "RW", _E, 40,           0,    254,   _U),
    (16, 2, "max_torque",            "RW", _E, 1000,         0,   1000,   _U),
    (18, 1, "phase",                 "RW", _E, 12,           0,    254,   _U),
    (19, 1, "unload_condition",      "RW", _E, 37,           0,    254,   _U),
    (20, 1, "led_alarm",             "RW", _E, 37,           0,    254,   _U),
    (21, 1, "p_gain",                "RW", _E, 32,           0,    254,   _U),
    (22, 1, "d_gain",                "RW", _E, 32,           0,    254,   _U),
    (23, 1, "i_gain",                "RW", _E, 0,            0,    254,   _U),
    (24, 1, "min_startup_force",     "RW", _E, 16,           0,    254,   _U),
    (25, 1, "integral_limit",        "RW", _E, 0,            0,    254,   _U),
    (26, 1, "cw_dead_zone",          "RW", _E, 1,            0,     16,   _U),
    (27, 1, "ccw_dead_zone",         "RW", _E, 1,            0,     16,   _U),
    (28, 2, "protection_current",    "RW", _E, 511,          0,   2047,   _U),
    (30, 1, "angular_resolution",    "RW", _E, 1,            1,    128,   _U),
    (31, 2, "homing_offset",         "RW", _E, 0,        -2047,   2047, _B11),
    (33, 1, "operating_mode",        "RW", _E, 0,            0,      3,   _U),
    (34, 1, "protective_torque",     "RW", _E, 20,           0,    254,   _U),
    (35, 1, "protection_time",       "RW", _E, 200,          0,    254,   _U),
    (36, 1, "overload_torque",       "RW", _E, 80,           0,    254,   _U),
    (37, 1, "speed_p_gain",          "RW", _E, 10,           0,    254,   _U),
    (38, 1, "over_current_time",     "RW", _E, 200,          0,    254,   _U),
    (39, 1, "speed_i_gain",          "RW", _E, 10,           0,    254,   _U),
    (40, 1, "torque_enable",         "RW", _M, 0,            0,    128,   _U),
    (41, 1, "acceleration",          "RW", _M, 0,            0,    254,   _U),
    (42, 2, "goal_position",         "RW", _M, 0,       -32767,  32767, _B15),
    (44, 2, "goal_time",             "RW", _M, 0,        -1023,   1023, _B10),
    (46, 2, "goal_speed",            "RW", _M, 0,       -32767,  32767, _B15),
    (48, 2, "torque_limit",          "RW", _M, 1000,         0,   1000,   _U),
    (55, 1, "lock",                  "RW", _M, 1,            0,      1,   _U),
    (56, 2, "present_position",      "R",  _M, 0,       -32767,  32767, _B15),
    (58, 2, "present_speed",         "R",  _M, 0,       -32767,  32767, _B15),
    (60, 2, "present_load",          "R",  _M, 0,        -1023,   1023, _B10),
    (62, 1, "present_voltage",       "R",  _M, 0,            0,    255,   _U),
    (63, 1, "present_temperature",   "R",  _M, 0,            0,    255,   _U),
    (64, 1, "async_write",           "R",  _M, 0,            0,      1,   _U),
    (65, 1, "status",                "R",  _M, 0,            0,    255,   _U),
    (66, 1, "moving",                "R",  _M, 0,            0,      1,   _U),
    (67, 2, "target_position",       "R",  _M, 0,       -32767,  32767, _B15),
    (69, 2, "present_current",       "R",  _M, 0,            0,  32767,   _U),
    (80, 1, "moving_threshold",      "RW", _E, 5,            0,    254,   _U),
    (81, 1, "dts",                   "RW", _E, 10,           0,    254,   _U),
    (82, 1, "speed_unit",            "RW", _E, 1,            0,    254,   _U),
    (83, 1, "hts",                   "RW", _E, 0,            0,    254,   _U),
    (84, 1, "max_speed_limit",       "RW", _E, (66, 90),     0,    254,   _U),
    (85, 1, "acceleration_limit",    "RW", _E, 254,          0,    254,   _U),
    (86, 1, "acceleration_multiple", "RW", _E, 1,            0,    254,   _U),
)
# fmt: on


def _pick(column: _Column, model: int) -> int:
    return column if isinstance(column, int) else column[model]


def _table(model: int) -> ServoTable:
    rows = tuple(
        Register(address, size, name, access == "RW", area, _pick(default, model), low, high, sign)
        for address, size, name, access, area, default, low, high, sign in _ROWS
    )
    return ServoTable(_MODELS[model], Family.FEETECH_STS, _NUMBER[model], 310, rows)


FEETECH_STS = tuple(_table(model) for model in range(len(_MODELS)))
