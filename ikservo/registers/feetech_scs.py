"""Feetech SCS servos, big-endian, with a potentiometer (SCSCL memory table; SCS15 manual 1.02).

The model numbers of SCS15 and SCS225 and the rows of the second series come from Feetech's program
FD 1.9.8.
"""

from __future__ import annotations

from ikservo.registers.control_table import Alarm, ControlTable, Family, RegisterName
from ikservo.registers.register import Access, Area, Register, SignMagnitude, Unsigned
from ikservo.registers.units import (
    CELSIUS,
    DECI_VOLT,
    MS_1,
    MS_10,
    NUMBER,
    PER_MILLE,
    PERCENT,
    TICK_200,
    TICK_300,
    TICK_RATE_200,
    TICK_RATE_300,
    US_2,
)

RO, RW = Access.RO, Access.RW
EEP, RAM = Area.EEPROM, Area.RAM
UINT = Unsigned()
SIGN7, SIGN10, SIGN15 = SignMagnitude(7), SignMagnitude(10), SignMagnitude(15)


# fmt: off
BAUD_RATES = {0: 1_000_000, 1: 500_000, 2: 250_000, 3: 128_000,
              4: 115_200,   5: 76_800,  6: 57_600,  7: 38_400}
ALARM_BITS = {0: Alarm.VOLTAGE, 2: Alarm.HEAT, 5: Alarm.OVERLOAD}


class FeetechSCS:
    """Registers of all SCS servos: 10-bit potentiometer, big-endian, no sync read."""

    family = Family.FEETECH_SCS
    byte_order = "big"
    ticks_per_turn = 1024 * 360 / 300
    baud_rates = BAUD_RATES
    alarm_bits = ALARM_BITS
    missing = frozenset({RegisterName.OPERATING_MODE, RegisterName.HOMING_OFFSET,
                         RegisterName.PROFILE_ACCELERATION})

    #                                addr size codec   unit           access area    raw range
    firmware_major        = Register(   0, 1,  UINT,   NUMBER,        RO,    EEP)
    firmware_minor        = Register(   1, 1,  UINT,   NUMBER,        RO,    EEP)
    end                   = Register(   2, 1,  UINT,   NUMBER,        RO,    EEP)
    model_number          = Register(   3, 2,  UINT,   NUMBER,        RO,    EEP)
    id                    = Register(   5, 1,  UINT,   NUMBER,        RW,    EEP,       0,   253)
    baud_rate             = Register(   6, 1,  UINT,   NUMBER,        RW,    EEP,       0,     7)
    return_delay          = Register(   7, 1,  UINT,   US_2,          RW,    EEP,       0,   254)
    response_level        = Register(   8, 1,  UINT,   NUMBER,        RW,    EEP,       0,     1)
    min_position_limit    = Register(   9, 2,  UINT,   TICK_300,      RW,    EEP,       0,  1023)
    max_position_limit    = Register(  11, 2,  UINT,   TICK_300,      RW,    EEP,       0,  1023)
    max_temperature_limit = Register(  13, 1,  UINT,   CELSIUS,       RW,    EEP,       0,   100)
    max_voltage_limit     = Register(  14, 1,  UINT,   DECI_VOLT,     RW,    EEP,       0,   254)
    min_voltage_limit     = Register(  15, 1,  UINT,   DECI_VOLT,     RW,    EEP,       0,   254)
    max_torque            = Register(  16, 2,  UINT,   PER_MILLE,     RW,    EEP,       0,  1023)
    phase                 = Register(  18, 1,  UINT,   NUMBER,        RW,    EEP,       0,   254)
    unload_condition      = Register(  19, 1,  UINT,   NUMBER,        RW,    EEP,       0,   254)
    led_alarm             = Register(  20, 1,  UINT,   NUMBER,        RW,    EEP,       0,   254)
    p_gain                = Register(  21, 1,  UINT,   NUMBER,        RW,    EEP,       0,   254)
    d_gain                = Register(  22, 1,  UINT,   NUMBER,        RW,    EEP,       0,   254)
    i_gain                = Register(  23, 1,  UINT,   NUMBER,        RW,    EEP,       0,   254)
    min_startup_force     = Register(  24, 2,  UINT,   PER_MILLE,     RW,    EEP,       0,  1000)
    cw_dead_zone          = Register(  26, 1,  UINT,   TICK_300,      RW,    EEP,       0,    32)
    ccw_dead_zone         = Register(  27, 1,  UINT,   TICK_300,      RW,    EEP,       0,    32)
    protective_torque     = Register(  37, 1,  UINT,   PERCENT,       RW,    EEP,       0,   254)
    protection_time       = Register(  38, 1,  UINT,   MS_10,         RW,    EEP,       0,   254)
    overload_torque       = Register(  39, 1,  UINT,   PERCENT,       RW,    EEP,       0,   254)
    torque_enable         = Register(  40, 1,  UINT,   NUMBER,        RW,    RAM,       0,     2)
    goal_position         = Register(  42, 2,  UINT,   TICK_300,      RW,    RAM,       0,  1023)
    # If both position limits are 0 (motor mode) this is a duty, with its direction in bit 10.
    goal_time             = Register(  44, 2,  UINT,   MS_1,          RW,    RAM,       0,  9999)
    goal_speed            = Register(  46, 2,  UINT,   TICK_RATE_300, RW,    RAM,       0,  1000)
    lock                  = Register(  48, 1,  UINT,   NUMBER,        RW,    RAM,       0,     1)
    present_position      = Register(  56, 2,  UINT,   TICK_300,      RO,    RAM)
    present_speed         = Register(  58, 2,  SIGN15, TICK_RATE_300, RO,    RAM)
    present_load          = Register(  60, 2,  SIGN10, PER_MILLE,     RO,    RAM)
    present_voltage       = Register(  62, 1,  UINT,   DECI_VOLT,     RO,    RAM)
    present_temperature   = Register(  63, 1,  UINT,   CELSIUS,       RO,    RAM)
    async_write           = Register(  64, 1,  UINT,   NUMBER,        RO,    RAM)
    status                = Register(  65, 1,  UINT,   NUMBER,        RO,    RAM)
    moving                = Register(  66, 1,  UINT,   NUMBER,        RO,    RAM)

    # The names that every family has
    profile_velocity      = goal_speed
    present_velocity      = present_speed
    alarms                = status
    eeprom_lock           = lock


class SCS0009(FeetechSCS, ControlTable):
    """Small servo: 6 V, 2.3 kg·cm, 1024 steps over 300 degrees."""

    model_name = "SCS0009"
    number = 1284


class SCS15(FeetechSCS, ControlTable):
    """Standard-size servo: 1024 steps over 200 degrees."""

    model_name = "SCS15"
    number = 1295
    ticks_per_turn = 1024 * 360 / 200

    min_position_limit    = Register(   9, 2,  UINT,   TICK_200,      RW,    EEP,       0,  1023)
    max_position_limit    = Register(  11, 2,  UINT,   TICK_200,      RW,    EEP,       0,  1023)
    cw_dead_zone          = Register(  26, 1,  UINT,   TICK_200,      RW,    EEP,       0,    32)
    ccw_dead_zone         = Register(  27, 1,  UINT,   TICK_200,      RW,    EEP,       0,    32)
    goal_position         = Register(  42, 2,  UINT,   TICK_200,      RW,    RAM,       0,  1023)
    goal_speed            = Register(  46, 2,  UINT,   TICK_RATE_200, RW,    RAM,       0,  1000)
    present_position      = Register(  56, 2,  UINT,   TICK_200,      RO,    RAM)
    present_speed         = Register(  58, 2,  SIGN15, TICK_RATE_200, RO,    RAM)

    profile_velocity      = goal_speed
    present_velocity      = present_speed


class SCS225(FeetechSCS, ControlTable):
    """Servo of the second series: 25 kg·cm at 7.4 V, 1024 steps over 300 degrees; measures current.

    The units of its currents and the direction of its offset are not known; ikservo uses neither.
    """

    model_name = "SCS225"
    number = 2339
    lacks = frozenset({"i_gain", "goal_time"})

    over_current_time     = Register(  31, 1,  UINT,   MS_10,         RW,    EEP,       0,   254)
    protection_current    = Register(  32, 2,  UINT,   NUMBER,        RW,    EEP,       0,  1023)
    position_offset       = Register(  34, 1,  SIGN7,  TICK_300,      RW,    EEP,    -127,   127)
    goal_pwm              = Register(  44, 2,  SIGN10, PER_MILLE,     RW,    RAM,   -1000,  1000)
    present_current       = Register(  69, 2,  SIGN15, NUMBER,        RO,    RAM)


TABLES: tuple[type[ControlTable], ...] = (SCS0009, SCS15, SCS225)
# fmt: on
