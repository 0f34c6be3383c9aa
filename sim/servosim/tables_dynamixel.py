"""Control tables of Dynamixel AX, MX, XL-320 and X servos (ROBOTIS e-manual)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields

from servosim.register import ServoTable, Sign, SimulatedArea, SimulatedFamily, SimulatedRegister

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

_XL_320: tuple[_Row, ...] = (
    # address size name           access area default    min     max   sign
    ( 0, 2, "model_number",         "R",  _EEPROM_1,  350,        0,  65535,   _U1),
    ( 2, 1, "firmware_version",     "R",  _EEPROM_1,   29,        0,    255,   _U1),
    ( 3, 1, "id",                   "RW", _EEPROM_1,    1,        0,    252,   _U1),
    ( 4, 1, "baud_rate",            "RW", _EEPROM_1,    3,        0,      3,   _U1),
    ( 5, 1, "return_delay_time",    "RW", _EEPROM_1,  250,        0,    254,   _U1),
    ( 6, 2, "cw_angle_limit",       "RW", _EEPROM_1,    0,        0,   1023,   _U1),
    ( 8, 2, "ccw_angle_limit",      "RW", _EEPROM_1, 1023,        0,   1023,   _U1),
    (11, 1, "operating_mode",       "RW", _EEPROM_1,    2,        1,      2,   _U1),
    (12, 1, "temperature_limit",    "RW", _EEPROM_1,   65,        0,    150,   _U1),
    (13, 1, "min_voltage_limit",    "RW", _EEPROM_1,   60,       50,    250,   _U1),
    (14, 1, "max_voltage_limit",    "RW", _EEPROM_1,   90,       50,    250,   _U1),
    (15, 2, "max_torque",           "RW", _EEPROM_1, 1023,        0,   1023,   _U1),
    (17, 1, "status_return_level",  "RW", _EEPROM_1,    2,        0,      2,   _U1),
    (18, 1, "shutdown",             "RW", _EEPROM_1,    3,        0,      7,   _U1),
    (24, 1, "torque_enable",        "RW", _RAM_1,    0,        0,      1,   _U1),
    (25, 1, "led",                  "RW", _RAM_1,    0,        0,      7,   _U1),
    (27, 1, "d_gain",               "RW", _RAM_1,    0,        0,    254,   _U1),
    (28, 1, "i_gain",               "RW", _RAM_1,    0,        0,    254,   _U1),
    (29, 1, "p_gain",               "RW", _RAM_1,   32,        0,    254,   _U1),
    (30, 2, "goal_position",        "RW", _RAM_1,    0,        0,   1023,   _U1),
    (32, 2, "moving_speed",         "RW", _RAM_1,    0,    -1023,   1023, _B10),
    (35, 2, "torque_limit",         "RW", _RAM_1, 1023,        0,   1023,   _U1),
    (37, 2, "present_position",     "R",  _RAM_1,    0,        0,   1023,   _U1),
    (39, 2, "present_speed",        "R",  _RAM_1,    0,    -1023,   1023, _B10),
    (41, 2, "present_load",         "R",  _RAM_1,    0,    -1023,   1023, _B10),
    (45, 1, "present_voltage",      "R",  _RAM_1,    0,        0,    255,   _U1),
    (46, 1, "present_temperature",  "R",  _RAM_1,    0,        0,    255,   _U1),
    (47, 1, "registered_instruction", "R", _RAM_1,   0,        0,      1,   _U1),
    (49, 1, "moving",               "R",  _RAM_1,    0,        0,      1,   _U1),
    (50, 1, "hardware_error_status", "R", _RAM_1,    0,        0,    255,   _U1),
    (51, 2, "punch",                "RW", _RAM_1,   32,        0,   1023,   _U1),
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
    ServoTable(
        model="XL-320",
        family=SimulatedFamily.DYNAMIXEL_320,
        number=350,
        firmware=29,
        registers=tuple(_make_register(row) for row in _XL_320),
        ticks_per_turn=1024 * 360.0 / 300.0,
        middle_tick=512,
        travel_rad=math.radians(300.0),
    ),
)


_E, _M = SimulatedArea.EEPROM, SimulatedArea.RAM
_U, _S = Sign.NONE, Sign.TWOS
_Column = int | str  # a number, or the name of a fact of the model
_MAX_TURNS = 1_044_479
_GOAL = 1_048_575


@dataclass(frozen=True, slots=True)
class _Model:
    """Facts that differ between the sheets of X servos; None means that the register is missing.

    Attributes:
        number: The model number.
        volts_min: Lowest setting of the voltage limits, in 0.1 V.
        volts_max: Highest setting, and factory value of the upper limit.
        volts_low: Factory value of the lower limit.
        current: Largest current, in its unit; None without a sensor.
        heat_limit: The temperature limit.
        velocity: Factory value of the velocity limit.
        velocity_i: I gain of the velocity.
        velocity_p: P gain of the velocity.
        position_d: D gain of the position.
        position_i: I gain of the position.
        position_p: P gain of the position.
        shutdown: Factory value.
        pwm_slope: Factory value; only the small 330 servos have it.
        port_mode: Factory value; only the 540 servos have external ports.
        shafts: Number of shafts; servos with two lack the startup configuration and the backup.
    """

    number: int
    volts_min: int
    volts_max: int
    volts_low: int
    current: int | None
    heat_limit: int
    velocity: int
    velocity_i: int
    velocity_p: int
    position_d: int
    position_i: int
    position_p: int
    shutdown: int = 52
    pwm_slope: int | None = None
    port_mode: int | None = None
    shafts: int = 1

    @property
    def facts(self) -> Mapping[str, int | None]:
        """All facts by name, including derived facts."""
        small = self.pwm_slope is not None
        return {field.name: getattr(self, field.name) for field in fields(self)} | {
            "firmware": 52 if small else 46,
            "baud": 6 if small else 7,
            "protocol_min": 2 if small else 1,
            "protocol_max": 22 if small else 2,
            "speed": 2047 if small else 1023,
            "startup": 0 if self.shafts == 1 else None,
            "port_data": None if self.port_mode is None else 0,
            "measures_current": None if self.current is None else 0,
            "measures_load": 0 if self.current is None else None,
        }


# fmt: off
_MODELS = {
    #                      number   volts  current heat velocity vi  vp   pd  pi  pp   stop
    "XL330-M288":  _Model(1200, 31,  70, 35, 1750, 70, 445,  1600, 180, 0,    0,  400,  53, 140),
    "XL330-M077":  _Model(1190, 31,  70, 35, 1750, 70, 1620, 400,  40,  0,   400, 400,  53, 140),
    "XC330-M288":  _Model(1240, 31,  70, 35, 2352, 70, 350,  1600, 50,  500,  0,  1100, 52, 140),
    "XC330-M181":  _Model(1230, 31,  70, 35, 2352, 70, 545,  1400, 100, 500,  0,  1200, 52, 140),
    "XC330-T288":  _Model(1220, 55, 140, 55,  910, 70, 320,  1200, 40,  0,    0,  900,  52, 255),
    "XC330-T181":  _Model(1210, 55, 140, 55,  910, 70, 510,  1200, 40,  0,    0,  900,  52, 255),
    "XL430-W250":  _Model(1060, 60, 140, 60, None, 72, 265,  1000, 100, 4000, 0,  640),
    "2XL430-W250": _Model(1090, 60, 140, 60, None, 72, 250,  1800, 100, 2000, 0,  640, shafts=2),
    "XC430-W240":  _Model(1080, 60, 160, 60, None, 80, 306,  1920, 100, 0,    0,  700),
    "XC430-W150":  _Model(1070, 60, 160, 60, None, 80, 460,  1920, 100, 0,    0,  460),
    "2XC430-W250": _Model(1160, 60, 160, 60, None, 80, 275,  1920, 100, 0,    0,  700, shafts=2),
    "XM430-W350":  _Model(1020, 95, 160, 95, 1193, 80, 350,  1920, 100, 0,    0,  800),
    "XM430-W210":  _Model(1030, 95, 160, 95, 1193, 80, 330,  1920, 100, 0,    0,  800),
    "XH430-W350":  _Model(1000, 95, 160, 95,  648, 80, 130,  1920, 100, 0,    0,  900),
    "XH430-W210":  _Model(1010, 95, 160, 95,  648, 80, 210,  1920, 100, 0,    0,  900),
    "XM540-W270":  _Model(1120, 95, 160, 95, 2047, 80, 128,  1920, 100, 0,    0,  800, port_mode=3),
    "XM540-W150":  _Model(1130, 95, 160, 95, 2047, 80, 230,  1920, 100, 0,    0,  800, port_mode=3),
    "XH540-W270":  _Model(1100, 95, 160, 95, 2047, 80, 167,  1920, 100, 0,    0,  800, port_mode=3),
    "XH540-W150":  _Model(1110, 95, 160, 95, 2047, 80, 300,  1920, 100, 0,    0,  800, port_mode=3),
}

_ROWS: tuple[tuple[int, int, str, str, SimulatedArea, _Column, _Column, _Column, Sign], ...] = (
    # adr size name                     access area default                  min      max      sign
    (  0, 2, "model_number",           "R",  _E, "number",                0,       65535,   _U),
    (  2, 4, "model_information",      "R",  _E, 0,                       0,       0,       _U),
    (  6, 1, "firmware_version",       "R",  _E, "firmware",              0,       255,     _U),
    (  7, 1, "id",                     "RW", _E, 1,                       0,       252,     _U),
    (  8, 1, "baud_rate",              "RW", _E, 1,                       0,       "baud",  _U),
    (  9, 1, "return_delay_time",      "RW", _E, 250,                     0,       254,     _U),
    ( 10, 1, "drive_mode",             "RW", _E, 0,                       0,       13,      _U),
    ( 11, 1, "operating_mode",         "RW", _E, 3,                       0,       16,      _U),
    ( 12, 1, "secondary_id",           "RW", _E, 255,                     0,       255,     _U),
    ( 13, 1, "protocol_type",          "RW", _E, 2,          "protocol_min", "protocol_max", _U),
    ( 20, 4, "homing_offset",          "RW", _E, 0,                 -_MAX_TURNS, _MAX_TURNS,  _S),
    ( 24, 4, "moving_threshold",       "RW", _E, 10,                      0,       1023,    _U),
    ( 31, 1, "temperature_limit",      "RW", _E, "heat_limit",            0,       100,     _U),
    ( 32, 2, "max_voltage_limit",      "RW", _E, "volts_max",     "volts_min", "volts_max", _U),
    ( 34, 2, "min_voltage_limit",      "RW", _E, "volts_low",     "volts_min", "volts_max", _U),
    ( 36, 2, "pwm_limit",              "RW", _E, 885,                     0,       885,     _U),
    ( 38, 2, "current_limit",          "RW", _E, "current",               0,       "current", _U),
    ( 44, 4, "velocity_limit",         "RW", _E, "velocity",              0,       "speed", _U),
    ( 48, 4, "max_position_limit",     "RW", _E, 4095,                    0,       4095,    _U),
    ( 52, 4, "min_position_limit",     "RW", _E, 0,                       0,       4095,    _U),
    ( 56, 1, "external_port_mode_1",   "RW", _E, "port_mode",             0,       3,       _U),
    ( 57, 1, "external_port_mode_2",   "RW", _E, "port_mode",             0,       3,       _U),
    ( 58, 1, "external_port_mode_3",   "RW", _E, "port_mode",             0,       3,       _U),
    ( 60, 1, "startup_configuration",  "RW", _E, "startup",               0,       3,       _U),
    ( 62, 1, "pwm_slope",              "RW", _E, "pwm_slope",             1,       255,     _U),
    ( 63, 1, "shutdown",               "RW", _E, "shutdown",              0,       63,      _U),
    ( 64, 1, "torque_enable",          "RW", _M, 0,                       0,       1,       _U),
    ( 65, 1, "led",                    "RW", _M, 0,                       0,       1,       _U),
    ( 68, 1, "status_return_level",    "RW", _M, 2,                       0,       2,       _U),
    ( 69, 1, "registered_instruction", "R",  _M, 0,                       0,       1,       _U),
    ( 70, 1, "hardware_error_status",  "R",  _M, 0,                       0,       255,     _U),
    ( 76, 2, "velocity_i_gain",        "RW", _M, "velocity_i",            0,       16383,   _U),
    ( 78, 2, "velocity_p_gain",        "RW", _M, "velocity_p",            0,       16383,   _U),
    ( 80, 2, "position_d_gain",        "RW", _M, "position_d",            0,       16383,   _U),
    ( 82, 2, "position_i_gain",        "RW", _M, "position_i",            0,       16383,   _U),
    ( 84, 2, "position_p_gain",        "RW", _M, "position_p",            0,       16383,   _U),
    ( 88, 2, "feedforward_2nd_gain",   "RW", _M, 0,                       0,       16383,   _U),
    ( 90, 2, "feedforward_1st_gain",   "RW", _M, 0,                       0,       16383,   _U),
    ( 98, 1, "bus_watchdog",           "RW", _M, 0,                       0,       127,     _S),
    (100, 2, "goal_pwm",               "RW", _M, 885,                     -885,    885,     _S),
    (102, 2, "goal_current",           "RW", _M, "current",               -2352,   2352,    _S),
    (104, 4, "goal_velocity",          "RW", _M, 0,                       -2047,   2047,    _S),
    (108, 4, "profile_acceleration",   "RW", _M, 0,                       0,       32767,   _U),
    (112, 4, "profile_velocity",       "RW", _M, 0,                       0,       32767,   _U),
    (116, 4, "goal_position",          "RW", _M, 0,                       -_GOAL,  _GOAL,   _S),
    (120, 2, "realtime_tick",          "R",  _M, 0,                       0,       32767,   _U),
    (122, 1, "moving",                 "R",  _M, 0,                       0,       1,       _U),
    (123, 1, "moving_status",          "R",  _M, 0,                       0,       255,     _U),
    (124, 2, "present_pwm",            "R",  _M, 0,                       -885,    885,     _S),
    (126, 2, "present_current",        "R",  _M, "measures_current",      -32768,  32767,   _S),
    (126, 2, "present_load",           "R",  _M, "measures_load",         -1000,   1000,    _S),
    (128, 4, "present_velocity",       "R",  _M, 0,                       -32768,  32767,   _S),
    (132, 4, "present_position",       "R",  _M, 0,                       -_GOAL,  _GOAL,   _S),
    (136, 4, "velocity_trajectory",    "R",  _M, 0,                       -32768,  32767,   _S),
    (140, 4, "position_trajectory",    "R",  _M, 0,                       -_GOAL,  _GOAL,   _S),
    (144, 2, "present_input_voltage",  "R",  _M, 0,                       0,       255,     _U),
    (146, 1, "present_temperature",    "R",  _M, 0,                       0,       255,     _U),
    (147, 1, "backup_ready",           "R",  _M, "startup",               0,       1,       _U),
    (152, 2, "external_port_data_1",   "RW", _M, "port_data",             0,       4095,    _U),
    (154, 2, "external_port_data_2",   "RW", _M, "port_data",             0,       4095,    _U),
    (156, 2, "external_port_data_3",   "RW", _M, "port_data",             0,       4095,    _U),
)

# Indirect registers: (number of the first, count, first address of the addresses, of the data)
_INDIRECT_SMALL = ((1, 20, 168, 208),)
_INDIRECT = ((1, 28, 168, 224), (29, 28, 578, 634))
# fmt: on


def _listed_registers(facts: Mapping[str, int | None]) -> Iterator[SimulatedRegister]:
    for address, size, name, access, area, *columns, sign in _ROWS:
        default, lower, upper = (facts[c] if isinstance(c, str) else c for c in columns)
        if default is not None and lower is not None and upper is not None:
            writable = access == "RW"
            yield SimulatedRegister(
                address, size, name, writable, area, default, lower, upper, sign
            )


def _indirect_registers(model: _Model) -> Iterator[SimulatedRegister]:
    blocks = _INDIRECT if model.pwm_slope is None else _INDIRECT_SMALL
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


def _make_table(name: str, model: _Model) -> ServoTable:
    facts = model.facts
    return ServoTable(
        model=name,
        family=SimulatedFamily.DYNAMIXEL_X,
        number=model.number,
        firmware=52 if model.pwm_slope is not None else 46,
        registers=(*_listed_registers(facts), *_indirect_registers(model)),
    )


DYNAMIXEL_X = tuple(_make_table(name, model) for name, model in _MODELS.items())
