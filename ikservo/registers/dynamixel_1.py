"""Dynamixel AX-12A and MX-28 with protocol 1.0, XL-320 with 2.0 (ROBOTIS e-manual)."""

from __future__ import annotations

from ikservo.registers.control_table import Alarm, ControlTable, Family, RegisterName
from ikservo.registers.register import (
    Access,
    Area,
    Register,
    SignMagnitude,
    TwosComplement,
    Unsigned,
)
from ikservo.registers.units import (
    CELSIUS,
    DECI_VOLT,
    DEG_S2_8_583,
    MS_1,
    NUMBER,
    PER_1023,
    RPM_0_111,
    RPM_0_114,
    TICK_300,
    TICK_4096,
    US_2,
)

RO, RW = Access.RO, Access.RW
EEP, RAM = Area.EEPROM, Area.RAM
UINT, SINT, SIGN10 = Unsigned(), TwosComplement(), SignMagnitude(10)


# fmt: off
# The register holds 2 000 000 / rate - 1, rounded; the MX has three additional, faster codes.
AX_BAUD_RATES = {1: 1_000_000, 3: 500_000,  4: 400_000, 7: 250_000, 9: 200_000,
                 16: 115_200,  34: 57_600, 103: 19_200, 207: 9_600}
MX_BAUD_RATES = AX_BAUD_RATES | {0: 2_000_000, 250: 2_250_000, 251: 2_500_000, 252: 3_000_000}
# Bits 1, 3, 4 and 6 of the error byte concern the request, not the servo.
ALARM_BITS = {0: Alarm.VOLTAGE, 2: Alarm.HEAT, 5: Alarm.OVERLOAD}
XL320_BAUD_RATES = {0: 9_600, 1: 57_600, 2: 115_200, 3: 1_000_000}
XL320_ALARM_BITS = {0: Alarm.OVERLOAD, 1: Alarm.HEAT, 2: Alarm.VOLTAGE}


class Dynamixel1:
    """Registers that all servos with protocol 1.0 have in common."""

    #                                 addr size codec   unit          access area    raw range
    model_number           = Register(   0, 2,  UINT,   NUMBER,       RO,    EEP)
    firmware_version       = Register(   2, 1,  UINT,   NUMBER,       RO,    EEP)
    id                     = Register(   3, 1,  UINT,   NUMBER,       RW,    EEP,       0,   253)
    baud_rate              = Register(   4, 1,  UINT,   NUMBER,       RW,    EEP,       0,   254)
    return_delay_time      = Register(   5, 1,  UINT,   US_2,         RW,    EEP,       0,   254)
    temperature_limit      = Register(  11, 1,  UINT,   CELSIUS,      RW,    EEP,       0,   100)
    min_voltage_limit      = Register(  12, 1,  UINT,   DECI_VOLT,    RW,    EEP,      50,   160)
    max_voltage_limit      = Register(  13, 1,  UINT,   DECI_VOLT,    RW,    EEP,      50,   160)
    max_torque             = Register(  14, 2,  UINT,   PER_1023,     RW,    EEP,       0,  1023)
    status_return_level    = Register(  16, 1,  UINT,   NUMBER,       RW,    EEP,       0,     2)
    alarm_led              = Register(  17, 1,  UINT,   NUMBER,       RW,    EEP,       0,   127)
    shutdown               = Register(  18, 1,  UINT,   NUMBER,       RW,    EEP,       0,   127)
    torque_enable          = Register(  24, 1,  UINT,   NUMBER,       RW,    RAM,       0,     1)
    led                    = Register(  25, 1,  UINT,   NUMBER,       RW,    RAM,       0,     1)
    torque_limit           = Register(  34, 2,  UINT,   PER_1023,     RW,    RAM,       0,  1023)
    present_load           = Register(  40, 2,  SIGN10, PER_1023,     RO,    RAM)
    present_voltage        = Register(  42, 1,  UINT,   DECI_VOLT,    RO,    RAM)
    present_temperature    = Register(  43, 1,  UINT,   CELSIUS,      RO,    RAM)
    registered             = Register(  44, 1,  UINT,   NUMBER,       RO,    RAM)
    moving                 = Register(  46, 1,  UINT,   NUMBER,       RO,    RAM)
    lock                   = Register(  47, 1,  UINT,   NUMBER,       RW,    RAM,       0,     1)

    # The names that every family has
    return_delay           = return_delay_time
    max_temperature_limit  = temperature_limit


class AX12A(Dynamixel1, ControlTable):
    """Small servo: 10-bit potentiometer over 300 degrees, alarms only in its replies."""

    model_name = "AX-12A"
    number = 12
    family = Family.DYNAMIXEL_1
    ticks_per_turn = 1024 * 360 / 300
    baud_rates = AX_BAUD_RATES
    alarm_bits = ALARM_BITS
    missing = frozenset({RegisterName.OPERATING_MODE, RegisterName.HOMING_OFFSET,
                         RegisterName.PROFILE_ACCELERATION, RegisterName.ALARMS})

    #                                 addr size codec   unit          access area    raw range
    cw_angle_limit         = Register(   6, 2,  UINT,   TICK_300,     RW,    EEP,       0,  1023)
    ccw_angle_limit        = Register(   8, 2,  UINT,   TICK_300,     RW,    EEP,       0,  1023)
    cw_compliance_margin   = Register(  26, 1,  UINT,   TICK_300,     RW,    RAM,       0,   255)
    ccw_compliance_margin  = Register(  27, 1,  UINT,   TICK_300,     RW,    RAM,       0,   255)
    cw_compliance_slope    = Register(  28, 1,  UINT,   TICK_300,     RW,    RAM,       0,   254)
    ccw_compliance_slope   = Register(  29, 1,  UINT,   TICK_300,     RW,    RAM,       0,   254)
    goal_position          = Register(  30, 2,  UINT,   TICK_300,     RW,    RAM,       0,  1023)
    moving_speed           = Register(  32, 2,  SIGN10, RPM_0_111,    RW,    RAM,   -1023,  1023)
    present_position       = Register(  36, 2,  UINT,   TICK_300,     RO,    RAM)
    present_speed          = Register(  38, 2,  SIGN10, RPM_0_111,    RO,    RAM)
    punch                  = Register(  48, 2,  UINT,   PER_1023,     RW,    RAM,      32,  1023)

    # The names that every family has
    min_position_limit     = cw_angle_limit
    max_position_limit     = ccw_angle_limit
    profile_velocity       = moving_speed
    present_velocity       = present_speed


class MX28(Dynamixel1, ControlTable):
    """Medium servo: 12-bit magnetic encoder, PID gains, bulk read."""

    model_name = "MX-28"
    number = 29
    family = Family.DYNAMIXEL_1
    ticks_per_turn = 4096
    baud_rates = MX_BAUD_RATES
    alarm_bits = ALARM_BITS
    bulk_read = True
    missing = frozenset({RegisterName.OPERATING_MODE, RegisterName.ALARMS})

    #                                 addr size codec   unit          access area    raw range
    cw_angle_limit         = Register(   6, 2,  UINT,   TICK_4096,    RW,    EEP,       0,  4095)
    ccw_angle_limit        = Register(   8, 2,  UINT,   TICK_4096,    RW,    EEP,       0,  4095)
    multi_turn_offset      = Register(  20, 2,  SINT,   TICK_4096,    RW,    EEP,  -24576, 24576)
    resolution_divider     = Register(  22, 1,  UINT,   NUMBER,       RW,    EEP,       1,     4)
    d_gain                 = Register(  26, 1,  UINT,   NUMBER,       RW,    RAM,       0,   254)
    i_gain                 = Register(  27, 1,  UINT,   NUMBER,       RW,    RAM,       0,   254)
    p_gain                 = Register(  28, 1,  UINT,   NUMBER,       RW,    RAM,       0,   254)
    goal_position          = Register(  30, 2,  SINT,   TICK_4096,    RW,    RAM,  -28672, 28672)
    moving_speed           = Register(  32, 2,  SIGN10, RPM_0_114,    RW,    RAM,   -1023,  1023)
    present_position       = Register(  36, 2,  SINT,   TICK_4096,    RO,    RAM)
    present_speed          = Register(  38, 2,  SIGN10, RPM_0_114,    RO,    RAM)
    punch                  = Register(  48, 2,  UINT,   PER_1023,     RW,    RAM,       0,  1023)
    realtime_tick          = Register(  50, 2,  UINT,   MS_1,         RO,    RAM)
    goal_acceleration      = Register(  73, 1,  UINT,   DEG_S2_8_583, RW,    RAM,       0,   254)

    # The names that every family has
    homing_offset          = multi_turn_offset
    min_position_limit     = cw_angle_limit
    max_position_limit     = ccw_angle_limit
    profile_acceleration   = goal_acceleration
    profile_velocity       = moving_speed
    present_velocity       = present_speed


class XL320(ControlTable):
    """Plastic servo for 7.4 V: registers like the AX, at other addresses, with protocol 2.0."""

    model_name = "XL-320"
    number = 350
    family = Family.DYNAMIXEL_2
    ticks_per_turn = 1024 * 360 / 300
    baud_rates = XL320_BAUD_RATES
    alarm_bits = XL320_ALARM_BITS
    position_modes = (2,)
    missing = frozenset({RegisterName.HOMING_OFFSET, RegisterName.PROFILE_ACCELERATION})

    #                                 addr size codec   unit          access area    raw range
    model_number           = Register(   0, 2,  UINT,   NUMBER,       RO,    EEP)
    firmware_version       = Register(   2, 1,  UINT,   NUMBER,       RO,    EEP)
    id                     = Register(   3, 1,  UINT,   NUMBER,       RW,    EEP,       0,   252)
    baud_rate              = Register(   4, 1,  UINT,   NUMBER,       RW,    EEP,       0,     3)
    return_delay_time      = Register(   5, 1,  UINT,   US_2,         RW,    EEP,       0,   254)
    cw_angle_limit         = Register(   6, 2,  UINT,   TICK_300,     RW,    EEP,       0,  1023)
    ccw_angle_limit        = Register(   8, 2,  UINT,   TICK_300,     RW,    EEP,       0,  1023)
    # "Control Mode" in the data sheet: 1 is wheel mode, 2 is joint mode.
    operating_mode         = Register(  11, 1,  UINT,   NUMBER,       RW,    EEP,       1,     2)
    temperature_limit      = Register(  12, 1,  UINT,   CELSIUS,      RW,    EEP,       0,   150)
    min_voltage_limit      = Register(  13, 1,  UINT,   DECI_VOLT,    RW,    EEP,      50,   250)
    max_voltage_limit      = Register(  14, 1,  UINT,   DECI_VOLT,    RW,    EEP,      50,   250)
    max_torque             = Register(  15, 2,  UINT,   PER_1023,     RW,    EEP,       0,  1023)
    status_return_level    = Register(  17, 1,  UINT,   NUMBER,       RW,    EEP,       0,     2)
    shutdown               = Register(  18, 1,  UINT,   NUMBER,       RW,    EEP,       0,     7)
    torque_enable          = Register(  24, 1,  UINT,   NUMBER,       RW,    RAM,       0,     1)
    led                    = Register(  25, 1,  UINT,   NUMBER,       RW,    RAM,       0,     7)
    d_gain                 = Register(  27, 1,  UINT,   NUMBER,       RW,    RAM,       0,   254)
    i_gain                 = Register(  28, 1,  UINT,   NUMBER,       RW,    RAM,       0,   254)
    p_gain                 = Register(  29, 1,  UINT,   NUMBER,       RW,    RAM,       0,   254)
    goal_position          = Register(  30, 2,  UINT,   TICK_300,     RW,    RAM,       0,  1023)
    moving_speed           = Register(  32, 2,  SIGN10, RPM_0_111,    RW,    RAM,   -1023,  1023)
    torque_limit           = Register(  35, 2,  UINT,   PER_1023,     RW,    RAM,       0,  1023)
    present_position       = Register(  37, 2,  UINT,   TICK_300,     RO,    RAM)
    present_speed          = Register(  39, 2,  SIGN10, RPM_0_111,    RO,    RAM)
    present_load           = Register(  41, 2,  SIGN10, PER_1023,     RO,    RAM)
    present_voltage        = Register(  45, 1,  UINT,   DECI_VOLT,    RO,    RAM)
    present_temperature    = Register(  46, 1,  UINT,   CELSIUS,      RO,    RAM)
    registered_instruction = Register(  47, 1,  UINT,   NUMBER,       RO,    RAM)
    moving                 = Register(  49, 1,  UINT,   NUMBER,       RO,    RAM)
    hardware_error_status  = Register(  50, 1,  UINT,   NUMBER,       RO,    RAM)
    punch                  = Register(  51, 2,  UINT,   PER_1023,     RW,    RAM,       0,  1023)

    # The names that every family has
    return_delay           = return_delay_time
    min_position_limit     = cw_angle_limit
    max_position_limit     = ccw_angle_limit
    max_temperature_limit  = temperature_limit
    profile_velocity       = moving_speed
    present_velocity       = present_speed
    alarms                 = hardware_error_status


TABLES: tuple[type[ControlTable], ...] = (AX12A, MX28, XL320)
# fmt: on
