"""Feetech SCS, big-endian: SCS0009 and SCS15 (SCSCL memory table; SCS15 & SCS115 manual 1.02).

Columns that differ between models hold one number a model, in the order of ``_MODELS``.
"""

from __future__ import annotations

import math

from servosim.tables.register import Area, Family, Register, ServoTable, Sign

__all__ = ["FEETECH_SCS"]

_E, _M = Area.EEPROM, Area.RAM
_U, _B10, _B15 = Sign.NONE, Sign.BIT10, Sign.BIT15
_Column = int | tuple[int, ...]

# fmt: off
_MODELS     = ("SCS0009", "SCS15")
_NUMBER     = (1284, 1295)          # SCS15: assumed, no sheet gives it
_TRAVEL_DEG = (300.0, 200.0)        # of 1024 steps
_LIMITS     = ((20, 0), (1003, 1023))

_ROWS: tuple[tuple[int, int, str, str, Area, _Column, int, int, Sign], ...] = (
    # address size name            access area  default     min     max   sign
    ( 0, 1, "firmware_major",        "R",  _E, 3,            0,    255,   _U),
    ( 1, 1, "firmware_minor",        "R",  _E, 1,            0,    255,   _U),
    ( 2, 1, "end",                   "R",  _E, 1,            0,      1,   _U),
    ( 3, 2, "model_number",          "R",  _E, _NUMBER,      0,  65535,   _U),
    ( 5, 1, "id",                    "RW", _E, 1,            0,    253,   _U),
    ( 6, 1, "baud_rate",             "RW", _E, 0,            0,      7,   _U),
    ( 7, 1, "return_delay",          "RW", _E, 0,            0,    254,   _U),
    ( 8, 1, "response_level",        "RW", _E, 1,            0,      1,   _U),
    ( 9, 2, "min_position_limit",    "RW", _E, _LIMITS[0],   0,   1023,   _U),
    (11, 2, "max_position_limit",    "RW", _E, _LIMITS[1],   0,   1023,   _U),
    (13, 1, "max_temperature_limit", "RW", _E, (70, 80),     0,    100,   _U),
    (14, 1, "max_voltage_limit",     "RW", _E, (80, 250),    0,    254,   _U),
    (15, 1, "min_voltage_limit",     "RW", _E, (40, 50),     0,    254,   _U),
    (16, 2, "max_torque",            "RW", _E, (1000, 1023), 0,   1023,   _U),
    (18, 1, "phase",                 "RW", _E, 8,            0,    254,   _U),
    (19, 1, "unload_condition",      "RW", _E, 37,           0,    254,   _U),
    (20, 1, "led_alarm",             "RW", _E, 37,           0,    254,   _U),
    (21, 1, "p_gain",                "RW", _E, 15,           0,    254,   _U),
    (22, 1, "d_gain",                "RW", _E, 0,            0,    254,   _U),
    (23, 1, "i_gain",                "RW", _E, 0,            0,    254,   _U),
    (24, 2, "min_startup_force",     "RW", _E, 0,            0,   1000,   _U),
    (26, 1, "cw_dead_zone",          "RW", _E, (1, 2),       0,     32,   _U),
    (27, 1, "ccw_dead_zone",         "RW", _E, (1, 2),       0,     32,   _U),
    (37, 1, "protective_torque",     "RW", _E, 20,           0,    254,   _U),
    (38, 1, "protection_time",       "RW", _E, 200,          0,    254,   _U),
    (39, 1, "overload_torque",       "RW", _E, 80,           0,    254,   _U),
    (40, 1, "torque_enable",         "RW", _M, 0,            0,      2,   _U),
    (42, 2, "goal_position",         "RW", _M, 0,            0,   1023,   _U),
    (44, 2, "goal_time",             "RW", _M, 0,        -1023,   9999, _B10),
    (46, 2, "goal_speed",            "RW", _M, 0,            0,   1000,   _U),
    (48, 1, "lock",                  "RW", _M, 1,            0,      1,   _U),
    (56, 2, "present_position",      "R",  _M, 0,            0,   1023,   _U),
    (58, 2, "present_speed",         "R",  _M, 0,       -32767,  32767, _B15),
    (60, 2, "present_load",          "R",  _M, 0,        -1023,   1023, _B10),
    (62, 1, "present_voltage",       "R",  _M, 0,            0,    255,   _U),
    (63, 1, "present_temperature",   "R",  _M, 0,            0,    255,   _U),
    (64, 1, "async_write",           "R",  _M, 0,            0,      1,   _U),
    (65, 1, "status",                "R",  _M, 0,            0,    255,   _U),
    (66, 1, "moving",                "R",  _M, 0,            0,      1,   _U),
)
# fmt: on


def _pick(column: _Column, model: int) -> int:
    return column if isinstance(column, int) else column[model]


def _register(row: tuple[int, int, str, str, Area, _Column, int, int, Sign], k: int) -> Register:
    address, size, name, access, area, default, low, high, sign = row
    at_first = _pick(default, k)
    return Register(address, size, name, access == "RW", area, at_first, low, high, sign, "big")


def _table(k: int) -> ServoTable:
    return ServoTable(
        model=_MODELS[k],
        family=Family.FEETECH_SCS,
        number=_NUMBER[k],
        firmware=301,
        registers=tuple(_register(row, k) for row in _ROWS),
        ticks_per_turn=1024 * 360.0 / _TRAVEL_DEG[k],
        middle_tick=512,
        travel_rad=math.radians(_TRAVEL_DEG[k]),
    )


FEETECH_SCS = tuple(_table(k) for k in range(len(_MODELS)))
