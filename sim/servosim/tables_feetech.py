"""Control tables of Feetech SCS, STS and HLS servos (Feetech memory tables; program FD 1.9.8).

Columns that differ between models have one number per model, in the order of the models; None marks
a register that the model lacks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from servosim.register import ServoTable, Sign, SimulatedArea, SimulatedFamily, SimulatedRegister

_SCS_EEPROM, _SCS_RAM = SimulatedArea.EEPROM, SimulatedArea.RAM
_SCS_U, _SCS_B10, _SCS_B15 = Sign.NONE, Sign.BIT10, Sign.BIT15
_ScsColumn = int | tuple[int | None, ...]

# fmt: off
_SCS_MODELS     = ("SCS0009", "SCS15", "SCS225")
_SCS_NUMBER     = (1284, 1295, 2339)
_TRAVEL_DEG = (300.0, 200.0, 300.0)        # travel of 1024 steps
_LIMITS     = ((20, 0, 0), (1003, 1023, 1023))
_FIRST, _SECOND = (0, 0, None), (None, None, 0)  # rows of one of the two series

_SCS_ROWS: tuple[tuple[int, int, str, str, SimulatedArea, _ScsColumn, int, int, Sign], ...] = (
    # address size name            access area  default     min     max   sign
    ( 0, 1, "firmware_major",        "R",  _SCS_EEPROM, 3,            0,    255,   _SCS_U),
    ( 1, 1, "firmware_minor",        "R",  _SCS_EEPROM, 1,            0,    255,   _SCS_U),
    ( 2, 1, "end",                   "R",  _SCS_EEPROM, 1,            0,      1,   _SCS_U),
    ( 3, 2, "model_number",          "R",  _SCS_EEPROM, _SCS_NUMBER,      0,  65535,   _SCS_U),
    ( 5, 1, "id",                    "RW", _SCS_EEPROM, 1,            0,    253,   _SCS_U),
    ( 6, 1, "baud_rate",             "RW", _SCS_EEPROM, 0,            0,      7,   _SCS_U),
    ( 7, 1, "return_delay",          "RW", _SCS_EEPROM, 0,            0,    254,   _SCS_U),
    ( 8, 1, "response_level",        "RW", _SCS_EEPROM, 1,            0,      1,   _SCS_U),
    ( 9, 2, "min_position_limit",    "RW", _SCS_EEPROM, _LIMITS[0],   0,   1023,   _SCS_U),
    (11, 2, "max_position_limit",    "RW", _SCS_EEPROM, _LIMITS[1],   0,   1023,   _SCS_U),
    (13, 1, "max_temperature_limit", "RW", _SCS_EEPROM, (70, 80, 80), 0,    100,   _SCS_U),
    (14, 1, "max_voltage_limit",     "RW", _SCS_EEPROM, (80, 250, 140), 0,    254,   _SCS_U),
    (15, 1, "min_voltage_limit",     "RW", _SCS_EEPROM, (40, 50, 40), 0,    254,   _SCS_U),
    (16, 2, "max_torque",            "RW", _SCS_EEPROM, (1000, 1023, 1000), 0,   1023,   _SCS_U),
    (18, 1, "phase",                 "RW", _SCS_EEPROM, 8,            0,    254,   _SCS_U),
    (19, 1, "unload_condition",      "RW", _SCS_EEPROM, 37,           0,    254,   _SCS_U),
    (20, 1, "led_alarm",             "RW", _SCS_EEPROM, 37,           0,    254,   _SCS_U),
    (21, 1, "p_gain",                "RW", _SCS_EEPROM, 15,           0,    254,   _SCS_U),
    (22, 1, "d_gain",                "RW", _SCS_EEPROM, 0,            0,    254,   _SCS_U),
    (23, 1, "i_gain",                "RW", _SCS_EEPROM, _FIRST,       0,    254,   _SCS_U),
    (24, 2, "min_startup_force",     "RW", _SCS_EEPROM, 0,            0,   1000,   _SCS_U),
    (26, 1, "cw_dead_zone",          "RW", _SCS_EEPROM, (1, 2, 2),    0,     32,   _SCS_U),
    (27, 1, "ccw_dead_zone",         "RW", _SCS_EEPROM, (1, 2, 2),    0,     32,   _SCS_U),
    (31, 1, "over_current_time",     "RW", _SCS_EEPROM, (None, None, 100), 0, 254,  _SCS_U),
    (32, 2, "protection_current",    "RW", _SCS_EEPROM, _SECOND,      0,   1023,   _SCS_U),
    (34, 1, "position_offset",       "RW", _SCS_EEPROM, _SECOND,   -127,    127,   Sign.BIT7),
    (37, 1, "protective_torque",     "RW", _SCS_EEPROM, 20,           0,    254,   _SCS_U),
    (38, 1, "protection_time",       "RW", _SCS_EEPROM, 200,          0,    254,   _SCS_U),
    (39, 1, "overload_torque",       "RW", _SCS_EEPROM, 80,           0,    254,   _SCS_U),
    (40, 1, "torque_enable",         "RW", _SCS_RAM, 0,            0,      2,   _SCS_U),
    (42, 2, "goal_position",         "RW", _SCS_RAM, 0,            0,   1023,   _SCS_U),
    (44, 2, "goal_time",             "RW", _SCS_RAM, _FIRST,   -1023,   9999, _SCS_B10),
    (44, 2, "goal_pwm",              "RW", _SCS_RAM, _SECOND,  -1000,   1000, _SCS_B10),
    (46, 2, "goal_speed",            "RW", _SCS_RAM, 0,            0,   1000,   _SCS_U),
    (48, 1, "lock",                  "RW", _SCS_RAM, 1,            0,      1,   _SCS_U),
    (56, 2, "present_position",      "R",  _SCS_RAM, 0,            0,   1023,   _SCS_U),
    (58, 2, "present_speed",         "R",  _SCS_RAM, 0,       -32767,  32767, _SCS_B15),
    (60, 2, "present_load",          "R",  _SCS_RAM, 0,        -1023,   1023, _SCS_B10),
    (62, 1, "present_voltage",       "R",  _SCS_RAM, 0,            0,    255,   _SCS_U),
    (63, 1, "present_temperature",   "R",  _SCS_RAM, 0,            0,    255,   _SCS_U),
    (64, 1, "async_write",           "R",  _SCS_RAM, 0,            0,      1,   _SCS_U),
    (65, 1, "status",                "R",  _SCS_RAM, 0,            0,    255,   _SCS_U),
    (66, 1, "moving",                "R",  _SCS_RAM, 0,            0,      1,   _SCS_U),
    (69, 2, "present_current",       "R",  _SCS_RAM, _SECOND, -32767,  32767, _SCS_B15),
)
# fmt: on


def _scs_registers(k: int) -> Iterator[SimulatedRegister]:
    for address, size, name, access, area, default, low, high, sign in _SCS_ROWS:
        at_first = default if isinstance(default, int) else default[k]
        if at_first is not None:
            yield SimulatedRegister(
                address, size, name, access == "RW", area, at_first, low, high, sign, "big"
            )


def _scs_table(k: int) -> ServoTable:
    return ServoTable(
        model=_SCS_MODELS[k],
        family=SimulatedFamily.FEETECH_SCS,
        number=_SCS_NUMBER[k],
        firmware=301,
        registers=tuple(_scs_registers(k)),
        ticks_per_turn=1024 * 360.0 / _TRAVEL_DEG[k],
        middle_tick=512,
        travel_rad=math.radians(_TRAVEL_DEG[k]),
    )


FEETECH_SCS = tuple(_scs_table(k) for k in range(len(_SCS_MODELS)))


_STS_EEPROM, _STS_RAM = SimulatedArea.EEPROM, SimulatedArea.RAM
_STS_U, _STS_SIGN_BIT_10, _B11, _STS_SIGN_BIT_15 = (
    Sign.NONE,
    Sign.BIT10,
    Sign.BIT11,
    Sign.BIT15,
)
_StsColumn = int | tuple[int, ...]

# fmt: off
_STS_MODELS = ("STS3215", "STS3215-C018", "STS3250", "STS3235")  # the first is for 7.4 V
_STS_NUMBER = (777, 777, 2825, 2057)

_STS_ROWS: tuple[tuple[int, int, str, str, SimulatedArea, _StsColumn, int, int, Sign], ...] = (
    # address size name            access area  default     min     max   sign
    ( 0, 1, "firmware_major",        "R",  _STS_EEPROM, 3,            0,    255,   _STS_U),
    ( 1, 1, "firmware_minor",        "R",  _STS_EEPROM, 10,           0,    255,   _STS_U),
    ( 2, 1, "end",                   "R",  _STS_EEPROM, 0,            0,      1,   _STS_U),
    ( 3, 2, "model_number",          "R",  _STS_EEPROM, _STS_NUMBER,      0,  65535,   _STS_U),
    ( 5, 1, "id",                    "RW", _STS_EEPROM, 1,            0,    253,   _STS_U),
    ( 6, 1, "baud_rate",             "RW", _STS_EEPROM, 0,            0,     11,   _STS_U),
    ( 7, 1, "return_delay",          "RW", _STS_EEPROM, 0,            0,    254,   _STS_U),
    ( 8, 1, "response_level",        "RW", _STS_EEPROM, 1,            0,      1,   _STS_U),
    ( 9, 2, "min_position_limit",    "RW", _STS_EEPROM, 0,            0,   4094,   _STS_U),
    (11, 2, "max_position_limit",    "RW", _STS_EEPROM, 4095,         0,   4095,   _STS_U),
    (13, 1, "max_temperature_limit", "RW", _STS_EEPROM, 70,           0,    100,   _STS_U),
    (14, 1, "max_voltage_limit",     "RW", _STS_EEPROM, (80, 140, 140, 140),  0,    254,   _STS_U),
    (15, 1, "min_voltage_limit",     "RW", _STS_EEPROM, 40,           0,    254,   _STS_U),
    (16, 2, "max_torque",            "RW", _STS_EEPROM, 1000,         0,   1000,   _STS_U),
    (18, 1, "phase",                 "RW", _STS_EEPROM, 12,           0,    254,   _STS_U),
    (19, 1, "unload_condition",      "RW", _STS_EEPROM, 37,           0,    254,   _STS_U),
    (20, 1, "led_alarm",             "RW", _STS_EEPROM, 37,           0,    254,   _STS_U),
    (21, 1, "p_gain",                "RW", _STS_EEPROM, 32,           0,    254,   _STS_U),
    (22, 1, "d_gain",                "RW", _STS_EEPROM, 32,           0,    254,   _STS_U),
    (23, 1, "i_gain",                "RW", _STS_EEPROM, 0,            0,    254,   _STS_U),
    (24, 1, "min_startup_force",     "RW", _STS_EEPROM, (16, 16, 5, 16),       0,    254,   _STS_U),
    (25, 1, "integral_limit",        "RW", _STS_EEPROM, 0,            0,    254,   _STS_U),
    (26, 1, "cw_dead_zone",          "RW", _STS_EEPROM, 1,            0,     16,   _STS_U),
    (27, 1, "ccw_dead_zone",         "RW", _STS_EEPROM, 1,            0,     16,   _STS_U),
    (28, 2, "protection_current",    "RW", _STS_EEPROM, 511,          0,   2047,   _STS_U),
    (30, 1, "angular_resolution",    "RW", _STS_EEPROM, 1,            1,    128,   _STS_U),
    (31, 2, "homing_offset",         "RW", _STS_EEPROM, 0,        -2047,   2047, _B11),
    (33, 1, "operating_mode",        "RW", _STS_EEPROM, 0,            0,      3,   _STS_U),
    (34, 1, "protective_torque",     "RW", _STS_EEPROM, 20,           0,    254,   _STS_U),
    (35, 1, "protection_time",       "RW", _STS_EEPROM, 200,          0,    254,   _STS_U),
    (36, 1, "overload_torque",       "RW", _STS_EEPROM, 80,           0,    254,   _STS_U),
    (37, 1, "speed_p_gain",          "RW", _STS_EEPROM, 10,           0,    254,   _STS_U),
    (38, 1, "over_current_time",     "RW", _STS_EEPROM, 200,          0,    254,   _STS_U),
    (39, 1, "speed_i_gain",          "RW", _STS_EEPROM, 10,           0,    254,   _STS_U),
    (40, 1, "torque_enable",         "RW", _STS_RAM, 0,            0,    128,   _STS_U),
    (41, 1, "acceleration",          "RW", _STS_RAM, 0,            0,    254,   _STS_U),
    (42, 2, "goal_position",         "RW", _STS_RAM, 0,       -32767,  32767, _STS_SIGN_BIT_15),
    (44, 2, "goal_time",             "RW", _STS_RAM, 0,        -1023,   1023, _STS_SIGN_BIT_10),
    (46, 2, "goal_speed",            "RW", _STS_RAM, 0,       -32767,  32767, _STS_SIGN_BIT_15),
    (48, 2, "torque_limit",          "RW", _STS_RAM, 1000,         0,   1000,   _STS_U),
    (55, 1, "lock",                  "RW", _STS_RAM, 1,            0,      1,   _STS_U),
    (56, 2, "present_position",      "R",  _STS_RAM, 0,       -32767,  32767, _STS_SIGN_BIT_15),
    (58, 2, "present_speed",         "R",  _STS_RAM, 0,       -32767,  32767, _STS_SIGN_BIT_15),
    (60, 2, "present_load",          "R",  _STS_RAM, 0,        -1023,   1023, _STS_SIGN_BIT_10),
    (62, 1, "present_voltage",       "R",  _STS_RAM, 0,            0,    255,   _STS_U),
    (63, 1, "present_temperature",   "R",  _STS_RAM, 0,            0,    255,   _STS_U),
    (64, 1, "async_write",           "R",  _STS_RAM, 0,            0,      1,   _STS_U),
    (65, 1, "status",                "R",  _STS_RAM, 0,            0,    255,   _STS_U),
    (66, 1, "moving",                "R",  _STS_RAM, 0,            0,      1,   _STS_U),
    (67, 2, "target_position",       "R",  _STS_RAM, 0,       -32767,  32767, _STS_SIGN_BIT_15),
    (69, 2, "present_current",       "R",  _STS_RAM, 0,            0,  32767,   _STS_U),
    (80, 1, "moving_threshold",      "RW", _STS_EEPROM, 5,            0,    254,   _STS_U),
    (81, 1, "dts",                   "RW", _STS_EEPROM, 10,           0,    254,   _STS_U),
    (82, 1, "speed_unit",            "RW", _STS_EEPROM, 1,            0,    254,   _STS_U),
    (83, 1, "hts",                   "RW", _STS_EEPROM, 0,            0,    254,   _STS_U),
    (84, 1, "max_speed_limit",       "RW", _STS_EEPROM, (66, 66, 110, 66), 0,    254,   _STS_U),
    (85, 1, "acceleration_limit",    "RW", _STS_EEPROM, 254,          0,    254,   _STS_U),
    (86, 1, "acceleration_multiple", "RW", _STS_EEPROM, 1,            0,    254,   _STS_U),
)
# fmt: on


def _make_sts_table(model: int) -> ServoTable:
    rows = tuple(
        SimulatedRegister(
            address,
            size,
            name,
            access == "RW",
            area,
            default if isinstance(default, int) else default[model],
            low,
            high,
            sign,
        )
        for address, size, name, access, area, default, low, high, sign in _STS_ROWS
    )
    return ServoTable(
        _STS_MODELS[model], SimulatedFamily.FEETECH_STS, _STS_NUMBER[model], 310, rows
    )


# fmt: off
_HLS_ROWS: tuple[tuple[int, int, str, str, SimulatedArea, int, int, int, Sign], ...] = (
    # address size name            access area         default     min     max   sign
    ( 0, 1, "firmware_major",        "R",  _STS_EEPROM, 3,          0,    255,   _STS_U),
    ( 1, 1, "firmware_minor",        "R",  _STS_EEPROM, 43,         0,    255,   _STS_U),
    ( 2, 1, "end",                   "R",  _STS_EEPROM, 0,          0,      1,   _STS_U),
    ( 3, 2, "model_number",          "R",  _STS_EEPROM, 2570,       0,  65535,   _STS_U),
    ( 5, 1, "id",                    "RW", _STS_EEPROM, 1,          0,    253,   _STS_U),
    ( 6, 1, "baud_rate",             "RW", _STS_EEPROM, 0,          0,      7,   _STS_U),
    ( 7, 1, "secondary_id",          "RW", _STS_EEPROM, 0,          0,    253,   _STS_U),
    ( 8, 1, "response_level",        "RW", _STS_EEPROM, 1,          0,      1,   _STS_U),
    ( 9, 2, "min_position_limit",    "RW", _STS_EEPROM, 0,          0,   4094,   _STS_U),
    (11, 2, "max_position_limit",    "RW", _STS_EEPROM, 4095,       0,   4095,   _STS_U),
    (13, 1, "max_temperature_limit", "RW", _STS_EEPROM, 70,         0,    100,   _STS_U),
    (14, 1, "max_voltage_limit",     "RW", _STS_EEPROM, 80,         0,    254,   _STS_U),
    (15, 1, "min_voltage_limit",     "RW", _STS_EEPROM, 40,         0,    254,   _STS_U),
    (16, 2, "max_torque",            "RW", _STS_EEPROM, 980,        0,   1000,   _STS_U),
    (18, 1, "phase",                 "RW", _STS_EEPROM, 0,          0,    254,   _STS_U),
    (19, 1, "unload_condition",      "RW", _STS_EEPROM, 37,         0,    254,   _STS_U),
    (20, 1, "led_alarm",             "RW", _STS_EEPROM, 37,         0,    254,   _STS_U),
    (21, 1, "p_gain",                "RW", _STS_EEPROM, 32,         0,    254,   _STS_U),
    (22, 1, "d_gain",                "RW", _STS_EEPROM, 32,         0,    254,   _STS_U),
    (23, 1, "i_gain",                "RW", _STS_EEPROM, 0,          0,    254,   _STS_U),
    (24, 1, "min_startup_force",     "RW", _STS_EEPROM, 16,         0,    254,   _STS_U),
    (25, 1, "integral_limit",        "RW", _STS_EEPROM, 0,          0,    254,   _STS_U),
    (26, 1, "cw_dead_zone",          "RW", _STS_EEPROM, 1,          0,     16,   _STS_U),
    (27, 1, "ccw_dead_zone",         "RW", _STS_EEPROM, 1,          0,     16,   _STS_U),
    (28, 2, "protection_current",    "RW", _STS_EEPROM, 500,        0,   2047,   _STS_U),
    (30, 1, "angular_resolution",    "RW", _STS_EEPROM, 1,          1,    128,   _STS_U),
    (31, 2, "homing_offset",         "RW", _STS_EEPROM, 0,      -4095,   4095, _STS_SIGN_BIT_15),
    (33, 1, "operating_mode",        "RW", _STS_EEPROM, 0,          0,      4,   _STS_U),
    (34, 1, "current_p_gain",        "RW", _STS_EEPROM, 32,         0,    254,   _STS_U),
    (35, 1, "current_i_gain",        "RW", _STS_EEPROM, 32,         0,    254,   _STS_U),
    (37, 1, "speed_p_gain",          "RW", _STS_EEPROM, 32,         0,    254,   _STS_U),
    (38, 1, "over_current_time",     "RW", _STS_EEPROM, 200,        0,    254,   _STS_U),
    (39, 1, "speed_i_gain",          "RW", _STS_EEPROM, 0,          0,    254,   _STS_U),
    (40, 1, "torque_enable",         "RW", _STS_RAM, 0,             0,      2,   _STS_U),
    (41, 1, "acceleration",          "RW", _STS_RAM, 0,             0,    254,   _STS_U),
    (42, 2, "goal_position",         "RW", _STS_RAM, 0,        -32767,  32767, _STS_SIGN_BIT_15),
    (44, 2, "goal_torque",           "RW", _STS_RAM, 0,         -2047,   2047, _STS_SIGN_BIT_15),
    (46, 2, "goal_speed",            "RW", _STS_RAM, 0,        -32767,  32767, _STS_SIGN_BIT_15),
    (48, 2, "torque_limit",          "RW", _STS_RAM, 980,           0,   1000,   _STS_U),
    (50, 1, "kp",                    "RW", _STS_RAM, 32,            0,    254,   _STS_U),
    (51, 1, "kd",                    "RW", _STS_RAM, 32,            0,    254,   _STS_U),
    (52, 1, "ki",                    "RW", _STS_RAM, 0,             0,    254,   _STS_U),
    (53, 1, "km",                    "RW", _STS_RAM, 0,             0,      1,   _STS_U),
    (55, 1, "lock",                  "RW", _STS_RAM, 1,             0,      1,   _STS_U),
    (56, 2, "present_position",      "R",  _STS_RAM, 0,        -32767,  32767, _STS_SIGN_BIT_15),
    (58, 2, "present_speed",         "R",  _STS_RAM, 0,        -32767,  32767, _STS_SIGN_BIT_15),
    (60, 2, "present_load",          "R",  _STS_RAM, 0,         -1023,   1023, _STS_SIGN_BIT_10),
    (62, 1, "present_voltage",       "R",  _STS_RAM, 0,             0,    255,   _STS_U),
    (63, 1, "present_temperature",   "R",  _STS_RAM, 0,             0,    255,   _STS_U),
    (64, 1, "async_write",           "R",  _STS_RAM, 0,             0,      1,   _STS_U),
    (65, 1, "status",                "R",  _STS_RAM, 0,             0,    255,   _STS_U),
    (66, 1, "moving",                "R",  _STS_RAM, 0,             0,      3,   _STS_U),
    (67, 2, "target_position",       "R",  _STS_RAM, 0,        -32767,  32767, _STS_SIGN_BIT_15),
    (69, 2, "present_current",       "R",  _STS_RAM, 0,        -32767,  32767, _STS_SIGN_BIT_15),
    (73, 2, "current_offset",        "R",  _STS_RAM, 0,        -32767,  32767, _STS_SIGN_BIT_15),
    (80, 1, "moving_threshold",      "R",  _STS_EEPROM, 1,          0,    254,   _STS_U),
    (84, 1, "max_speed_limit",       "R",  _STS_EEPROM, 160,        0,    254,   _STS_U),
    (85, 1, "acceleration_limit",    "R",  _STS_EEPROM, 254,        0,    254,   _STS_U),
    (86, 1, "acceleration_multiple", "R",  _STS_EEPROM, 1,          0,    254,   _STS_U),
)
# fmt: on


def _make_hls_table() -> ServoTable:
    rows = tuple(
        SimulatedRegister(address, size, name, access == "RW", area, default, low, high, sign)
        for address, size, name, access, area, default, low, high, sign in _HLS_ROWS
    )
    return ServoTable("HLS3606M", SimulatedFamily.FEETECH_STS, 2570, 343, rows)


FEETECH_STS = (*(_make_sts_table(model) for model in range(len(_STS_MODELS))), _make_hls_table())
