"""Dynamixel X servos: the control tables of the e-manual, protocol 2.0."""

from __future__ import annotations

from ikservo.registers.control_table import Alarm, ControlTable, Family, OperatingMode
from ikservo.registers.register import Access, Area, Register, TwosComplement, Unsigned
from ikservo.registers.units import (
    CELSIUS,
    DECI_VOLT,
    MA_1,
    MA_2_69,
    MS_1,
    MS_20,
    MV_PER_MS,
    MV_PER_MS_12,
    NUMBER,
    PER_MILLE,
    PWM_885,
    RPM2_214_577,
    RPM_0_229,
    TICK_4096,
    US_2,
)

RO, RW = Access.RO, Access.RW
EEP, RAM = Area.EEPROM, Area.RAM
UINT, SINT = Unsigned(), TwosComplement()


# fmt: off
BAUD_RATES = {0: 9_600,     1: 57_600,    2: 115_200,   3: 1_000_000,
              4: 2_000_000, 5: 3_000_000, 6: 4_000_000, 7: 4_500_000}
ALARM_BITS = {0: Alarm.VOLTAGE, 2: Alarm.HEAT, 3: Alarm.ENCODER, 4: Alarm.SHOCK,
              5: Alarm.OVERLOAD}


class DynamixelX:
    """Registers of all X servos: 12-bit encoder, little-endian, two's complement."""

    family = Family.DYNAMIXEL_2
    ticks_per_turn = 4096
    baud_rates = BAUD_RATES
    alarm_bits = ALARM_BITS
    position_modes = (OperatingMode.POSITION, OperatingMode.EXTENDED_POSITION,
                      OperatingMode.CURRENT_BASED_POSITION)

    #                                 addr size codec unit        access area     raw range
    model_number           = Register(   0, 2,  UINT, NUMBER,       RO,  EEP)
    model_information      = Register(   2, 4,  UINT, NUMBER,       RO,  EEP)
    firmware_version       = Register(   6, 1,  UINT, NUMBER,       RO,  EEP)
    id                     = Register(   7, 1,  UINT, NUMBER,       RW,  EEP,        0,      252)
    baud_rate              = Register(   8, 1,  UINT, NUMBER,       RW,  EEP,        0,        7)
    return_delay_time      = Register(   9, 1,  UINT, US_2,         RW,  EEP,        0,      254)
    drive_mode             = Register(  10, 1,  UINT, NUMBER,       RW,  EEP,        0,       13)
    operating_mode         = Register(  11, 1,  UINT, NUMBER,       RW,  EEP,        0,       16)
    secondary_id           = Register(  12, 1,  UINT, NUMBER,       RW,  EEP)
    protocol_type          = Register(  13, 1,  UINT, NUMBER,       RW,  EEP,        1,        2)
    homing_offset          = Register(  20, 4,  SINT, TICK_4096,    RW,  EEP, -1044479,  1044479)
    moving_threshold       = Register(  24, 4,  UINT, RPM_0_229,    RW,  EEP,        0,     1023)
    temperature_limit      = Register(  31, 1,  UINT, CELSIUS,      RW,  EEP,        0,      100)
    max_voltage_limit      = Register(  32, 2,  UINT, DECI_VOLT,    RW,  EEP,       95,      160)
    min_voltage_limit      = Register(  34, 2,  UINT, DECI_VOLT,    RW,  EEP,       95,      160)
    pwm_limit              = Register(  36, 2,  UINT, PWM_885,      RW,  EEP,        0,      885)
    velocity_limit         = Register(  44, 4,  UINT, RPM_0_229,    RW,  EEP,        0,     1023)
    max_position_limit     = Register(  48, 4,  UINT, TICK_4096,    RW,  EEP,        0,     4095)
    min_position_limit     = Register(  52, 4,  UINT, TICK_4096,    RW,  EEP,        0,     4095)
    startup_configuration  = Register(  60, 1,  UINT, NUMBER,       RW,  EEP,        0,        3)
    shutdown               = Register(  63, 1,  UINT, NUMBER,       RW,  EEP)
    torque_enable          = Register(  64, 1,  UINT, NUMBER,       RW,  RAM,        0,        1)
    led                    = Register(  65, 1,  UINT, NUMBER,       RW,  RAM,        0,        1)
    status_return_level    = Register(  68, 1,  UINT, NUMBER,       RW,  RAM,        0,        2)
    registered_instruction = Register(  69, 1,  UINT, NUMBER,       RO,  RAM)
    hardware_error_status  = Register(  70, 1,  UINT, NUMBER,       RO,  RAM)
    velocity_i_gain        = Register(  76, 2,  UINT, NUMBER,       RW,  RAM,        0,    16383)
    velocity_p_gain        = Register(  78, 2,  UINT, NUMBER,       RW,  RAM,        0,    16383)
    position_d_gain        = Register(  80, 2,  UINT, NUMBER,       RW,  RAM,        0,    16383)
    position_i_gain        = Register(  82, 2,  UINT, NUMBER,       RW,  RAM,        0,    16383)
    position_p_gain        = Register(  84, 2,  UINT, NUMBER,       RW,  RAM,        0,    16383)
    feedforward_2nd_gain   = Register(  88, 2,  UINT, NUMBER,       RW,  RAM,        0,    16383)
    feedforward_1st_gain   = Register(  90, 2,  UINT, NUMBER,       RW,  RAM,        0,    16383)
    bus_watchdog           = Register(  98, 1,  SINT, MS_20,        RW,  RAM,        0,      127)
    goal_pwm               = Register( 100, 2,  SINT, PWM_885,      RW,  RAM,     -885,      885)
    goal_velocity          = Register( 104, 4,  SINT, RPM_0_229,    RW,  RAM,    -1023,     1023)
    # Milliseconds instead if bit 2 of drive_mode selects time-based profiles.
    profile_acceleration   = Register( 108, 4,  UINT, RPM2_214_577, RW,  RAM,        0,    32767)
    profile_velocity       = Register( 112, 4,  UINT, RPM_0_229,    RW,  RAM,        0,    32767)
    goal_position          = Register( 116, 4,  SINT, TICK_4096,    RW,  RAM, -1048575,  1048575)
    realtime_tick          = Register( 120, 2,  UINT, MS_1,         RO,  RAM)
    moving                 = Register( 122, 1,  UINT, NUMBER,       RO,  RAM)
    moving_status          = Register( 123, 1,  UINT, NUMBER,       RO,  RAM)
    present_pwm            = Register( 124, 2,  SINT, PWM_885,      RO,  RAM)
    present_velocity       = Register( 128, 4,  SINT, RPM_0_229,    RO,  RAM)
    present_position       = Register( 132, 4,  SINT, TICK_4096,    RO,  RAM)
    velocity_trajectory    = Register( 136, 4,  SINT, RPM_0_229,    RO,  RAM)
    position_trajectory    = Register( 140, 4,  SINT, TICK_4096,    RO,  RAM)
    present_input_voltage  = Register( 144, 2,  UINT, DECI_VOLT,    RO,  RAM)
    present_temperature    = Register( 146, 1,  UINT, CELSIUS,      RO,  RAM)
    backup_ready           = Register( 147, 1,  UINT, NUMBER,       RO,  RAM)

    # The names that every family has
    return_delay           = return_delay_time
    max_temperature_limit  = temperature_limit
    present_voltage        = present_input_voltage
    alarms                 = hardware_error_status


class X330:
    """Registers of the small servos, which report current in milliamperes."""

    baud_rate              = Register(   8, 1,  UINT, NUMBER,       RW,  EEP,        0,        6)
    protocol_type          = Register(  13, 1,  UINT, NUMBER,       RW,  EEP,        2,       22)
    max_voltage_limit      = Register(  32, 2,  UINT, DECI_VOLT,    RW,  EEP,       31,       70)
    min_voltage_limit      = Register(  34, 2,  UINT, DECI_VOLT,    RW,  EEP,       31,       70)
    velocity_limit         = Register(  44, 4,  UINT, RPM_0_229,    RW,  EEP,        0,     2047)
    pwm_slope              = Register(  62, 1,  UINT, MV_PER_MS,    RW,  EEP,        1,      255)
    goal_velocity          = Register( 104, 4,  SINT, RPM_0_229,    RW,  RAM,    -2047,     2047)
    present_current        = Register( 126, 2,  SINT, MA_1,         RO,  RAM)

    present_load           = present_current


class XL330M288(X330, DynamixelX, ControlTable):
    """Small 5 V servo."""

    model_name = "XL330-M288"
    number = 1200

    current_limit          = Register(  38, 2,  UINT, MA_1,         RW,  EEP,        0,     1750)
    goal_current           = Register( 102, 2,  SINT, MA_1,         RW,  RAM,    -1750,     1750)


class XL330M077(X330, DynamixelX, ControlTable):
    """The XL330-M288 with a faster gear, 77 to 1."""

    model_name = "XL330-M077"
    number = 1190

    current_limit          = XL330M288.current_limit
    goal_current           = XL330M288.goal_current


class XC330M288(X330, DynamixelX, ControlTable):
    """The XL330's case with a coreless motor and metal gears; it reports the supply current."""

    model_name = "XC330-M288"
    number = 1240

    current_limit          = Register(  38, 2,  UINT, MA_1,         RW,  EEP,        0,     2352)
    goal_current           = Register( 102, 2,  SINT, MA_1,         RW,  RAM,    -2352,     2352)


class XC330M181(X330, DynamixelX, ControlTable):
    """The XC330-M288 with a faster gear, 181 to 1."""

    model_name = "XC330-M181"
    number = 1230

    current_limit          = XC330M288.current_limit
    goal_current           = XC330M288.goal_current


class XC330T:
    """Registers of the XC330 for 12 V."""

    max_voltage_limit      = Register(  32, 2,  UINT, DECI_VOLT,    RW,  EEP,       55,      140)
    min_voltage_limit      = Register(  34, 2,  UINT, DECI_VOLT,    RW,  EEP,       55,      140)
    current_limit          = Register(  38, 2,  UINT, MA_1,         RW,  EEP,        0,      910)
    pwm_slope              = Register(  62, 1,  UINT, MV_PER_MS_12, RW,  EEP,        1,      255)
    goal_current           = Register( 102, 2,  SINT, MA_1,         RW,  RAM,     -910,      910)


class XC330T288(XC330T, X330, DynamixelX, ControlTable):
    """The XC330 for 12 V."""

    model_name = "XC330-T288"
    number = 1220


class XC330T181(XC330T, X330, DynamixelX, ControlTable):
    """The XC330-T288 with a faster gear, 181 to 1."""

    model_name = "XC330-T181"
    number = 1210


class XL430:
    """Registers of the 12 V servos without a current sensor, which report load instead."""

    max_voltage_limit      = Register(  32, 2,  UINT, DECI_VOLT,    RW,  EEP,       60,      140)
    min_voltage_limit      = Register(  34, 2,  UINT, DECI_VOLT,    RW,  EEP,       60,      140)
    present_load           = Register( 126, 2,  SINT, PER_MILLE,    RO,  RAM)


class XL430W250(XL430, DynamixelX, ControlTable):
    """12 V servo without a current sensor."""

    model_name = "XL430-W250"
    number = 1060


class DualXL430W250(XL430, DynamixelX, ControlTable):
    """Two XL430 in one case, with one id and one table per shaft."""

    model_name = "2XL430-W250"
    number = 1090
    lacks = frozenset({"startup_configuration", "backup_ready"})


class XC430:
    """Registers of the XC430: the XL430's case, coreless motor, metal gears, up to 16 V."""

    max_voltage_limit      = Register(  32, 2,  UINT, DECI_VOLT,    RW,  EEP,       60,      160)
    min_voltage_limit      = Register(  34, 2,  UINT, DECI_VOLT,    RW,  EEP,       60,      160)


class XC430W240(XC430, XL430, DynamixelX, ControlTable):
    """The XL430 with a coreless motor and metal gears."""

    model_name = "XC430-W240"
    number = 1080


class XC430W150(XC430, XL430, DynamixelX, ControlTable):
    """The XC430-W240 with a faster gear, 160 to 1."""

    model_name = "XC430-W150"
    number = 1070


class DualXC430W250(XC430, XL430, DynamixelX, ControlTable):
    """Two XC430 in one case, with one id and one table per shaft."""

    model_name = "2XC430-W250"
    number = 1160
    lacks = DualXL430W250.lacks


class X430:
    """Registers of the servos that measure the motor's current."""

    current_limit          = Register(  38, 2,  UINT, MA_2_69,      RW,  EEP,        0,     1193)
    goal_current           = Register( 102, 2,  SINT, MA_2_69,      RW,  RAM,    -1193,     1193)
    present_current        = Register( 126, 2,  SINT, MA_2_69,      RO,  RAM)

    present_load           = present_current


class XM430W350(X430, DynamixelX, ControlTable):
    """12 V servo with a current sensor."""

    model_name = "XM430-W350"
    number = 1020


class XM430W210(X430, DynamixelX, ControlTable):
    """The XM430-W350 with a faster gear, 213 to 1."""

    model_name = "XM430-W210"
    number = 1030


class XH430W350(X430, DynamixelX, ControlTable):
    """The XM430's case with a Maxon motor, which draws half the current."""

    model_name = "XH430-W350"
    number = 1000

    current_limit          = Register(  38, 2,  UINT, MA_2_69,      RW,  EEP,        0,      648)
    goal_current           = Register( 102, 2,  SINT, MA_2_69,      RW,  RAM,     -648,      648)


class XH430W210(X430, DynamixelX, ControlTable):
    """The XH430-W350 with a faster gear, 213 to 1."""

    model_name = "XH430-W210"
    number = 1010

    current_limit          = XH430W350.current_limit
    goal_current           = XH430W350.goal_current


class X540:
    """Registers of the X540 servos, with twice the current of the X430, and external ports."""

    current_limit          = Register(  38, 2,  UINT, MA_2_69,      RW,  EEP,        0,     2047)
    external_port_mode_1   = Register(  56, 1,  UINT, NUMBER,       RW,  EEP,        0,        3)
    external_port_mode_2   = Register(  57, 1,  UINT, NUMBER,       RW,  EEP,        0,        3)
    external_port_mode_3   = Register(  58, 1,  UINT, NUMBER,       RW,  EEP,        0,        3)
    goal_current           = Register( 102, 2,  SINT, MA_2_69,      RW,  RAM,    -2047,     2047)
    external_port_data_1   = Register( 152, 2,  UINT, NUMBER,       RW,  RAM,        0,     4095)
    external_port_data_2   = Register( 154, 2,  UINT, NUMBER,       RW,  RAM,        0,     4095)
    external_port_data_3   = Register( 156, 2,  UINT, NUMBER,       RW,  RAM,        0,     4095)


class XM540W270(X540, X430, DynamixelX, ControlTable):
    """Large 12 V servo, for example for a shoulder joint."""

    model_name = "XM540-W270"
    number = 1120


class XM540W150(X540, X430, DynamixelX, ControlTable):
    """The XM540-W270 with a faster gear, 152 to 1."""

    model_name = "XM540-W150"
    number = 1130


class XH540W270(X540, X430, DynamixelX, ControlTable):
    """The XM540's case with a Maxon motor."""

    model_name = "XH540-W270"
    number = 1100


class XH540W150(X540, X430, DynamixelX, ControlTable):
    """The XH540-W270 with a faster gear, 152 to 1."""

    model_name = "XH540-W150"
    number = 1110


TABLES: tuple[type[ControlTable], ...] = (
    XL330M288, XL330M077, XC330M288, XC330M181, XC330T288, XC330T181,
    XL430W250, DualXL430W250, XC430W240, XC430W150, DualXC430W250,
    XM430W350, XM430W210, XH430W350, XH430W210,
    XM540W270, XM540W150, XH540W270, XH540W150,
)
# fmt: on
