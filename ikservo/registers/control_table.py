"""Control tables of servo models, register names common to all families, and alarms."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum, StrEnum
from typing import ClassVar

from ikservo.errors import UnknownNameError
from ikservo.registers.register import ByteOrder, Register


class Alarm(StrEnum):
    """An alarm that a servo reports; the value is its text for the user."""

    VOLTAGE = "supply voltage outside its limits"
    ENCODER = "position sensor fault"
    HEAT = "too hot"
    CURRENT = "too much current"
    SHOCK = "electrical shock or insufficient motor power"
    OVERLOAD = "overload"
    UNKNOWN = "hardware alert, see its error register"


def decode_alarms(bits: int, meaning: Mapping[int, Alarm]) -> frozenset[Alarm]:
    """Decode the alarms in a status byte; an unknown bit is reported as ``Alarm.UNKNOWN``."""
    if not bits:
        return frozenset()
    set_bits = (bit for bit in range(8) if bits >> bit & 1)
    return frozenset(meaning.get(bit, Alarm.UNKNOWN) for bit in set_bits)


class Family(StrEnum):
    """The protocol family of a servo; the value is the name in arm.toml."""

    FEETECH_STS = "feetech_sts"
    FEETECH_SCS = "feetech_scs"
    DYNAMIXEL_1 = "dynamixel_1"
    DYNAMIXEL_2 = "dynamixel_2"


class OperatingMode(IntEnum):
    """Control mode of a Dynamixel X: its register ``operating_mode`` (e-manual, address 11)."""

    CURRENT = 0
    VELOCITY = 1
    POSITION = 3
    EXTENDED_POSITION = 4
    CURRENT_BASED_POSITION = 5
    PWM = 16


class FeetechMode(IntEnum):
    """Control mode of a Feetech STS: its register ``operating_mode`` (memory table, address 33)."""

    POSITION = 0
    SPEED = 1
    PWM = 2
    STEP = 3


class RegisterName(StrEnum):
    """Common names for registers that most families have under different vendor names.

    ``bus.read(3, RegisterName.PRESENT_VOLTAGE)`` finds ``present_voltage`` in a Feetech servo and
    ``present_input_voltage`` in a Dynamixel.
    """

    MODEL_NUMBER = "model_number"
    ID = "id"
    BAUD_RATE = "baud_rate"
    RETURN_DELAY = "return_delay"
    OPERATING_MODE = "operating_mode"
    HOMING_OFFSET = "homing_offset"
    MIN_POSITION_LIMIT = "min_position_limit"
    MAX_POSITION_LIMIT = "max_position_limit"
    MAX_TEMPERATURE_LIMIT = "max_temperature_limit"
    MIN_VOLTAGE_LIMIT = "min_voltage_limit"
    MAX_VOLTAGE_LIMIT = "max_voltage_limit"
    TORQUE_ENABLE = "torque_enable"
    PROFILE_ACCELERATION = "profile_acceleration"
    PROFILE_VELOCITY = "profile_velocity"
    GOAL_POSITION = "goal_position"
    PRESENT_POSITION = "present_position"
    PRESENT_VELOCITY = "present_velocity"
    PRESENT_LOAD = "present_load"
    PRESENT_VOLTAGE = "present_voltage"
    PRESENT_TEMPERATURE = "present_temperature"
    MOVING = "moving"
    ALARMS = "alarms"


class ControlTable:
    """The control table of one servo model; never instantiated.

    Attributes:
        model_name: The name on the case and in arm.toml.
        number: Value of the servo's model register.
        family: The protocol family.
        byte_order: The byte order of 16- and 32-bit values on the line.
        ticks_per_turn: Counts of the present position in a full revolution of the horn; not an
            integer if the sensor covers less than a revolution.
        baud_rates: The rate [bit/s] of each code in the baud rate register.
        alarm_bits: The meaning of each bit of the alarm register.
        eeprom_lock: The register that must be 0 for EEPROM writes to be stored, if the family has
            such a register that can be unlocked again.
        position_modes: Numbers of the operating modes that hold a position, single-turn mode first;
            empty for a family without such a register.
        fine_speed_bit: Bit of the register ``phase`` that makes one count of speed 1 tick/s instead
            of 50 tick/s; 0 if the unit is fixed.
        bulk_read: Whether the model supports bulk read; only used for protocol 1.0.
        missing: Register names that the model does not have.
        lacks: Rows of the series that the model does not have, by their vendor names.
        non_idempotent: Raw writes that must not be repeated after a lost reply, as (name, number).
        registers: Every register by its vendor name, ordered by address.
    """

    model_name: ClassVar[str] = ""
    number: ClassVar[int]
    family: ClassVar[Family]
    byte_order: ClassVar[ByteOrder] = "little"
    ticks_per_turn: ClassVar[float]
    baud_rates: ClassVar[Mapping[int, int]]
    alarm_bits: ClassVar[Mapping[int, Alarm]]
    eeprom_lock: ClassVar[Register | None] = None
    position_modes: ClassVar[tuple[int, ...]] = ()
    fine_speed_bit: ClassVar[int] = 0
    bulk_read: ClassVar[bool] = False
    missing: ClassVar[frozenset[RegisterName]] = frozenset()
    lacks: ClassVar[frozenset[str]] = frozenset()
    non_idempotent: ClassVar[frozenset[tuple[str, int]]] = frozenset()
    registers: ClassVar[Mapping[str, Register]] = {}

    model_number: ClassVar[Register]
    id: ClassVar[Register]
    baud_rate: ClassVar[Register]
    return_delay: ClassVar[Register]
    operating_mode: ClassVar[Register]
    homing_offset: ClassVar[Register]
    min_position_limit: ClassVar[Register]
    max_position_limit: ClassVar[Register]
    max_temperature_limit: ClassVar[Register]
    min_voltage_limit: ClassVar[Register]
    max_voltage_limit: ClassVar[Register]
    torque_enable: ClassVar[Register]
    profile_acceleration: ClassVar[Register]
    profile_velocity: ClassVar[Register]
    goal_position: ClassVar[Register]
    present_position: ClassVar[Register]
    present_velocity: ClassVar[Register]
    present_load: ClassVar[Register]
    present_voltage: ClassVar[Register]
    present_temperature: ClassVar[Register]
    moving: ClassVar[Register]
    alarms: ClassVar[Register]

    def __init_subclass__(cls) -> None:
        """Collect the registers: the rows of the series, overridden by the table's own rows."""
        rows = [entry for each in reversed(cls.__mro__) for entry in vars(each).values()]
        own = (row for row in rows if isinstance(row, Register) and row.name not in cls.lacks)
        merged = {row.name: row for row in own}
        cls.registers = dict(sorted(merged.items(), key=lambda item: item[1].address))

    @classmethod
    def find(cls, ref: Register | RegisterName) -> Register:
        """Find a register by its name, or by the corresponding register of another model.

        Raises:
            UnknownNameError: This model has no such register.
        """
        found: Register | None
        if isinstance(ref, RegisterName):
            named: Register | None = getattr(cls, ref, None)
            found, name = named and cls.registers.get(named.name), ref.value
        else:
            found, name = cls.registers.get(ref.name), ref.name
        if found is None:
            raise UnknownNameError(f"{cls.model_name} register", name, cls.registers)
        return found

    @classmethod
    def decode_alarms(cls, bits: int) -> frozenset[Alarm]:
        """Decode the alarms in the bits of the alarm register."""
        return decode_alarms(bits, cls.alarm_bits)
