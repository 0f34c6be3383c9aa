"""Feetech STS and HLS servos, little-endian, sign-magnitude (Feetech memory tables)."""

from __future__ import annotations

from ikservo.registers.control_table import Alarm, ControlTable, Family, FeetechMode, RegisterName
from ikservo.registers.register import Access, Area, Register, SignMagnitude, Unsigned
from ikservo.registers.units import (
    CELSIUS,
    DECI_VOLT,
    MA_6_5,
    MS_1,
    MS_10,
    NUMBER,
    PER_MILLE,
    PERCENT,
    TICK_4096,
    TICK_ACCEL,
    TICK_RATE,
    TICK_RATE_50,
    US_2,
)

RO, RW = Access.RO, Access.RW
EEP, RAM = Area.EEPROM, Area.RAM
UINT, SIGN10, SIGN11, SIGN15 = Unsigned(), SignMagnitude(10), SignMagnitude(11), SignMagnitude(15)


# fmt: off
BAUD_RATES = {0: 1_000_000, 1: 500_000, 2: 250_000, 3: 128_000,
              4: 115_200,   5: 76_800,  6: 57_600,  7: 38_400,
              8: 19_200,    9: 14_400, 10: 9_600,  11: 4_800}
ALARM_BITS = {0: Alarm.VOLTAGE, 1: Alarm.ENCODER, 2: Alarm.HEAT, 3: Alarm.CURRENT,
              5: Alarm.OVERLOAD}


class FeetechSTS:
    """Registers of all STS servos: 12-bit magnetic encoder, little-endian."""

    family = Family.FEETECH_STS
    ticks_per_turn = 4096
    baud_rates = BAUD_RATES
    alarm_bits = ALARM_BITS
    position_modes = (FeetechMode.POSITION,)
    fine_speed_bit = 0b100
    # Writing 128 makes the present position tick 2048; a retry after a motion would set another.
    non_idempotent = frozenset({("torque_enable", 128)})

    #                                addr size codec   unit        access area    raw range
    firmware_major        = Register(   0, 1,  UINT,   NUMBER,     RO,    EEP)
    firmware_minor        = Register(   1, 1,  UINT,   NUMBER,     RO,    EEP)
    end                   = Register(   2, 1,  UINT,   NUMBER,     RO,    EEP)
    model_number          = Register(   3, 2,  UINT,   NUMBER,     RO,    EEP)
    id                    = Register(   5, 1,  UINT,   NUMBER,     RW,    EEP,       0,   253)
    baud_rate             = Register(   6, 1,  UINT,   NUMBER,     RW,    EEP,       0,    11)
    return_delay          = Register(   7, 1,  UINT,   US_2,       RW,    EEP,       0,   254)
    response_level        = Register(   8, 1,  UINT,   NUMBER,     RW,    EEP,       0,     1)
    min_position_limit    = Register(   9, 2,  UINT,   TICK_4096,  RW,    EEP,       0,  4094)
    max_position_limit    = Register(  11, 2,  UINT,   TICK_4096,  RW,    EEP,       0,  4095)
    max_temperature_limit = Register(  13, 1,  UINT,   CELSIUS,    RW,    EEP,       0,   100)
    max_voltage_limit     = Register(  14, 1,  UINT,   DECI_VOLT,  RW,    EEP,       0,   254)
    min_voltage_limit     = Register(  15, 1,  UINT,   DECI_VOLT,  RW,    EEP,       0,   254)
    max_torque            = Register(  16, 2,  UINT,   PER_MILLE,  RW,    EEP,       0,  1000)
    phase                 = Register(  18, 1,  UINT,   NUMBER,     RW,    EEP)
    unload_condition      = Register(  19, 1,  UINT,   NUMBER,     RW,    EEP,       0,   254)
    led_alarm             = Register(  20, 1,  UINT,   NUMBER,     RW,    EEP,       0,   254)
    p_gain                = Register(  21, 1,  UINT,   NUMBER,     RW,    EEP,       0,   254)
    d_gain                = Register(  22, 1,  UINT,   NUMBER,     RW,    EEP,       0,   254)
    i_gain                = Register(  23, 1,  UINT,   NUMBER,     RW,    EEP,       0,   254)
    min_startup_force     = Register(  24, 1,  UINT,   PER_MILLE,  RW,    EEP,       0,   254)
    integral_limit        = Register(  25, 1,  UINT,   NUMBER,     RW,    EEP,       0,   254)
    cw_dead_zone          = Register(  26, 1,  UINT,   TICK_4096,  RW,    EEP,       0,    16)
    ccw_dead_zone         = Register(  27, 1,  UINT,   TICK_4096,  RW,    EEP,       0,    16)
    protection_current    = Register(  28, 2,  UINT,   MA_6_5,     RW,    EEP,       0,  2047)
    angular_resolution    = Register(  30, 1,  UINT,   NUMBER,     RW,    EEP,       1,   128)
    homing_offset         = Register(  31, 2,  SIGN11, TICK_4096,  RW,    EEP,   -2047,  2047)
    operating_mode        = Register(  33, 1,  UINT,   NUMBER,     RW,    EEP,       0,     3)
    protective_torque     = Register(  34, 1,  UINT,   PERCENT,    RW,    EEP,       0,   254)
    protection_time       = Register(  35, 1,  UINT,   MS_10,      RW,    EEP,       0,   254)
    overload_torque       = Register(  36, 1,  UINT,   PERCENT,    RW,    EEP,       0,   254)
    speed_p_gain          = Register(  37, 1,  UINT,   NUMBER,     RW,    EEP,       0,   254)
    over_current_time     = Register(  38, 1,  UINT,   MS_10,      RW,    EEP,       0,   254)
    speed_i_gain          = Register(  39, 1,  UINT,   NUMBER,     RW,    EEP,       0,   254)
    torque_enable         = Register(  40, 1,  UINT,   NUMBER,     RW,    RAM,       0,   128)
    acceleration          = Register(  41, 1,  UINT,   TICK_ACCEL, RW,    RAM,       0,   254)
    goal_position         = Register(  42, 2,  SIGN15, TICK_4096,  RW,    RAM,  -32767, 32767)
    goal_time             = Register(  44, 2,  SIGN10, PER_MILLE,  RW,    RAM,   -1000,  1000)
    goal_speed            = Register(  46, 2,  SIGN15, TICK_RATE,  RW,    RAM,  -32767, 32767)
    torque_limit          = Register(  48, 2,  UINT,   PER_MILLE,  RW,    RAM,       0,  1000)
    lock                  = Register(  55, 1,  UINT,   NUMBER,     RW,    RAM,       0,     1)
    present_position      = Register(  56, 2,  SIGN15, TICK_4096,  RO,    RAM)
    present_speed         = Register(  58, 2,  SIGN15, TICK_RATE,  RO,    RAM)
    present_load          = Register(  60, 2,  SIGN10, PER_MILLE,  RO,    RAM)
    present_voltage       = Register(  62, 1,  UINT,   DECI_VOLT,  RO,    RAM)
    present_temperature   = Register(  63, 1,  UINT,   CELSIUS,    RO,    RAM)
    async_write           = Register(  64, 1,  UINT,   NUMBER,     RO,    RAM)
    status                = Register(  65, 1,  UINT,   NUMBER,     RO,    RAM)
    moving                = Register(  66, 1,  UINT,   NUMBER,     RO,    RAM)
    target_position       = Register(  67, 2,  SIGN15, TICK_4096,  RO,    RAM)
    present_current       = Register(  69, 2,  UINT,   MA_6_5,     RO,    RAM)

    # The vendor's own settings, at addresses after the RAM; they also survive loss of power
    moving_threshold      = Register(  80, 1,  UINT,   NUMBER,     RW,    EEP,       0,   254)
    dts                   = Register(  81, 1,  UINT,   MS_1,       RW,    EEP,       0,   254)
    speed_unit            = Register(  82, 1,  UINT,   NUMBER,     RW,    EEP,       0,   254)
    hts                   = Register(  83, 1,  UINT,   NUMBER,     RW,    EEP,       0,   254)
    max_speed_limit       = Register(  84, 1,  UINT,   NUMBER,     RW,    EEP,       0,   254)
    acceleration_limit    = Register(  85, 1,  UINT,   TICK_ACCEL, RW,    EEP,       0,   254)
    acceleration_multiple = Register(  86, 1,  UINT,   NUMBER,     RW,    EEP,       0,   254)

    # The names that every family has
    profile_acceleration  = acceleration
    profile_velocity      = goal_speed
    present_velocity      = present_speed
    alarms                = status
    eeprom_lock           = lock


class STS3215(FeetechSTS, ControlTable):
    """Bus servo of the SO-100 and SO-101, for 7.4 V or 12 V."""

    model_name = "STS3215"
    number = 777


class STS3250(FeetechSTS, ControlTable):
    """12 V servo with 50 kg·cm and steel gears."""

    model_name = "STS3250"
    number = 2825


class STS3235(FeetechSTS, ControlTable):
    """The 12 V STS3215 in an aluminium case."""

    model_name = "STS3235"
    number = 2057


class HLS:
    """Registers in which the HLS series differs: a current loop, speeds in units of 50 tick/s.

    Sources: Feetech's memory table of the series, and the list of models and registers of its
    program FD 1.9.8. The meaning of goal torque in speed and PWM mode is unknown.
    """

    baud_rates = {code: rate for code, rate in BAUD_RATES.items() if code <= 7}  # noqa: RUF012
    fine_speed_bit = 0
    non_idempotent = frozenset[tuple[str, int]]()
    missing = frozenset({RegisterName.RETURN_DELAY})
    lacks = frozenset({"return_delay", "protective_torque", "protection_time", "overload_torque",
                       "goal_time", "dts", "speed_unit", "hts"})

    baud_rate             = Register(   6, 1,  UINT,   NUMBER,     RW,    EEP,       0,     7)
    secondary_id          = Register(   7, 1,  UINT,   NUMBER,     RW,    EEP,       0,   253)
    homing_offset         = Register(  31, 2,  SIGN15, TICK_4096,  RW,    EEP,   -4095,  4095)
    operating_mode        = Register(  33, 1,  UINT,   NUMBER,     RW,    EEP,       0,     4)
    current_p_gain        = Register(  34, 1,  UINT,   NUMBER,     RW,    EEP,       0,   254)
    current_i_gain        = Register(  35, 1,  UINT,   NUMBER,     RW,    EEP,       0,   254)
    torque_enable         = Register(  40, 1,  UINT,   NUMBER,     RW,    RAM,       0,     2)
    # Maximum current during a motion to a goal; with 0 the servo does not move at all.
    goal_torque           = Register(  44, 2,  SIGN15, MA_6_5,     RW,    RAM,   -2047,  2047)
    goal_speed            = Register(  46, 2,  SIGN15, TICK_RATE_50, RW,  RAM,  -32767, 32767)
    # Position gains, loaded from the EEPROM at power-up
    kp                    = Register(  50, 1,  UINT,   NUMBER,     RW,    RAM,       0,   254)
    kd                    = Register(  51, 1,  UINT,   NUMBER,     RW,    RAM,       0,   254)
    ki                    = Register(  52, 1,  UINT,   NUMBER,     RW,    RAM,       0,   254)
    km                    = Register(  53, 1,  UINT,   NUMBER,     RW,    RAM,       0,     1)
    present_speed         = Register(  58, 2,  SIGN15, TICK_RATE_50, RO,  RAM)
    present_current       = Register(  69, 2,  SIGN15, MA_6_5,     RO,    RAM)
    current_offset        = Register(  73, 2,  SIGN15, NUMBER,     RO,    RAM)
    moving_threshold      = Register(  80, 1,  UINT,   NUMBER,     RO,    EEP)
    max_speed_limit       = Register(  84, 1,  UINT,   NUMBER,     RO,    EEP)
    acceleration_limit    = Register(  85, 1,  UINT,   TICK_ACCEL, RO,    EEP)
    acceleration_multiple = Register(  86, 1,  UINT,   NUMBER,     RO,    EEP)

    profile_velocity      = goal_speed
    present_velocity      = present_speed


class HLS3606M(HLS, FeetechSTS, ControlTable):
    """Small 6 V servo with a current loop."""

    model_name = "HLS3606M"
    number = 2570


TABLES: tuple[type[ControlTable], ...] = (STS3215, STS3250, STS3235, HLS3606M)
# fmt: on
