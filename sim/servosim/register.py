"""Rows of a datasheet's control table, the encoding of numbers, the memory of one servo."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from functools import partial
from struct import Struct
from typing import Literal

Order = Literal["little", "big"]


class SimulatedArea(Enum):
    """Memory area: EEPROM survives loss of power; RAM does not."""

    EEPROM = "E"
    RAM = "M"


class Sign(Enum):
    """Encoding of negative numbers; the value is the number of the sign bit."""

    NONE = -1
    TWOS = 0
    BIT7 = 7
    BIT10 = 10
    BIT11 = 11
    BIT15 = 15


class SimulatedFamily(Enum):
    """Servos with the same protocol and the same behaviour of their registers."""

    DYNAMIXEL_X = "dynamixel_2"
    DYNAMIXEL_1 = "dynamixel_1"
    DYNAMIXEL_320 = "dynamixel_320"
    FEETECH_STS = "feetech_sts"
    FEETECH_SCS = "feetech_scs"


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedRegister:
    """One row of a control table.

    Attributes:
        address: Address of its first byte.
        size: Number of bytes.
        name: The vendor's English name, snake_case.
        writable: Whether an instruction may write it.
        area: EEPROM or RAM.
        default: Factory value, or value after power-up for RAM.
        lower: Smallest value a write may carry.
        upper: Largest value a write may carry.
        sign: Encoding of negative numbers.
        order: Byte order.
        end: First address after it.
        persists: Whether it survives loss of power.
        sign_bit: The bit that makes a sign-magnitude number negative, or 0.
        twos: Whether negative numbers are two's complements.
        mask: Mask of all its bits.
    """

    address: int
    size: int
    name: str
    writable: bool
    area: SimulatedArea
    default: int
    lower: int
    upper: int
    sign: Sign = Sign.NONE
    order: Order = "little"
    end: int = field(init=False)
    persists: bool = field(init=False)
    sign_bit: int = field(init=False)
    twos: bool = field(init=False)
    mask: int = field(init=False)

    def __post_init__(self) -> None:
        bit = self.sign.value
        object.__setattr__(self, "end", self.address + self.size)
        object.__setattr__(self, "persists", self.area is SimulatedArea.EEPROM)
        object.__setattr__(self, "sign_bit", 1 << bit if bit > 0 else 0)
        object.__setattr__(self, "twos", self.sign is Sign.TWOS)
        object.__setattr__(self, "mask", (1 << 8 * self.size) - 1)

    def decode(self, raw: bytes | bytearray) -> int:
        """Decode the number in ``raw``."""
        value = int.from_bytes(raw, self.order, signed=self.twos)
        bit = self.sign_bit
        if not bit:
            return value
        magnitude = value & (bit - 1)
        return -magnitude if value & bit else magnitude

    def encode(self, value: int) -> bytes:
        """Encode the bytes of ``value``; excess bits are cut off as in the servo's RAM."""
        bit = self.sign_bit
        if bit:
            value = abs(value) & (bit - 1) | (bit if value < 0 else 0)
        return (value & self.mask).to_bytes(self.size, self.order)

    def accepts(self, value: int) -> bool:
        """Check whether ``value`` is in the datasheet's range."""
        return self.lower <= value <= self.upper


@dataclass(frozen=True, slots=True)
class ServoTable:
    """The whole control table of one model.

    Attributes:
        model: The model's name.
        family: The servos that behave like it.
        number: The model number in its memory.
        firmware: The firmware version that the defaults belong to.
        registers: Rows in the order of their addresses.
        ticks_per_turn: Steps of the sensor in one revolution.
        middle_tick: The tick in the middle of the travel.
        travel_rad: Range of the shaft; infinite if it has no stops.
        size: First address after the table.
    """

    model: str
    family: SimulatedFamily
    number: int
    firmware: int
    registers: tuple[SimulatedRegister, ...]
    ticks_per_turn: float = 4096
    middle_tick: int = 2048
    travel_rad: float = math.inf
    size: int = field(init=False)
    by_name: dict[str, SimulatedRegister] = field(init=False)
    by_byte: tuple[SimulatedRegister | None, ...] = field(init=False)
    _covered: dict[tuple[int, int], tuple[SimulatedRegister, ...]] = field(
        init=False, default_factory=dict[tuple[int, int], tuple["SimulatedRegister", ...]]
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "size", max(row.end for row in self.registers))
        object.__setattr__(self, "by_name", {row.name: row for row in self.registers})
        bytes_: list[SimulatedRegister | None] = [None] * self.size
        for row in self.registers:
            bytes_[row.address : row.end] = [row] * row.size
        object.__setattr__(self, "by_byte", tuple(bytes_))

    def is_gapless(self, address: int, length: int) -> bool:
        """Check whether every byte of a range belongs to a register."""
        return (
            length > 0
            and None not in self.by_byte[address : address + length]
            and (address + length <= self.size)
        )

    def registers_in(self, address: int, length: int) -> tuple[SimulatedRegister, ...]:
        """Return the registers that a range of bytes overlaps, in order."""
        found = self._covered.get((address, length))
        if found is None:
            touched = {id(row): row for row in self.by_byte[address : address + length] if row}
            found = tuple(touched.values())
            if address + length <= self.size:
                self._covered[address, length] = found
        return found


class Memory:
    """The bytes behind a control table.

    ``image`` is the memory that instructions read and write; ``eeprom`` survives loss of power.
    Access is not checked here, because that is the task of the servo's firmware.

    Attributes:
        get: Returns the value of a register by its name, for every frame and every protection.
    """

    def __init__(self, table: ServoTable, delivered: Mapping[str, int] | None = None) -> None:
        self.table = table
        self._eeprom_end = max(row.end for row in table.registers if row.persists)
        self.image = bytearray(table.size)  # always the same object: live servos reference it
        self._getters = {row.name: _make_getter(self.image, row) for row in table.registers}
        self._numbers: dict[str, int] = {}  # numbers of all registers, decoded when bytes change
        self.get: Callable[[str], int] = self._numbers.__getitem__
        self.eeprom = bytearray(table.size)
        self.eeprom_writes = 0
        self._backup = bytes(self._factory_image())
        self.restore_factory()
        for name, value in (delivered or {}).items():
            self.put(name, value)
            self._persist_register(table.by_name[name])

    def read(self, address: int, length: int) -> bytes:
        """Read bytes; gaps between registers and addresses after the table read as zero."""
        raw = bytes(self.image[address : address + length])
        return raw if len(raw) == length else raw.ljust(length, b"\x00")

    def put(self, name: str, value: int) -> None:
        """Set a register as the firmware does: no checks, RAM image only."""
        self.put_row(self.table.by_name[name], value)

    def put_row(self, row: SimulatedRegister, value: int) -> None:
        """Set the register of a row as `put` does."""
        self.image[row.address : row.end] = row.encode(value)
        self._numbers[row.name] = self._getters[row.name]()

    def persist_value(self, name: str) -> None:
        """Make a register's present value survive a power loss, even if the EEPROM is locked."""
        self._persist_register(self.table.by_name[name])

    def write(self, address: int, data: bytes, *, persist: bool = True) -> None:
        """Store bytes in the image, and those of EEPROM registers permanently if ``persist``."""
        self.image[address : address + len(data)] = data
        rows = self.table.registers_in(address, len(data))
        for row in rows:
            self._numbers[row.name] = self._getters[row.name]()
        if persist and address < self._eeprom_end:
            for row in rows:
                self._persist_register(row)

    def power_cycle(self) -> None:
        """Reset the RAM to its defaults and restore the EEPROM's bytes."""
        for row in self.table.registers:
            if row.persists:
                self.image[row.address : row.end] = self.eeprom[row.address : row.end]
            else:
                self.image[row.address : row.end] = row.encode(row.default)
        self._decode_all()

    def store_backup(self) -> None:
        """Store the present EEPROM registers for the next `restore_factory`."""
        kept = self._factory_image()
        for row in self.table.registers:
            if row.persists:
                kept[row.address : row.end] = self.eeprom[row.address : row.end]
        self._backup = bytes(kept)

    def restore_factory(self, keep: tuple[str, ...] = ()) -> None:
        """Set every register to its default or backed-up value, except those to keep."""
        for row in self.table.registers:
            if row.name not in keep:
                self.image[row.address : row.end] = self._backup[row.address : row.end]
                if row.persists:
                    self.eeprom[row.address : row.end] = self._backup[row.address : row.end]
        self._decode_all()

    def _decode_all(self) -> None:
        self._numbers.update((name, decode()) for name, decode in self._getters.items())

    def _factory_image(self) -> bytearray:
        """Return the datasheet's default of every register."""
        image = bytearray(self.table.size)
        for row in self.table.registers:
            image[row.address : row.end] = row.encode(row.default)
        return image

    def _persist_register(self, row: SimulatedRegister) -> None:
        if row.persists:
            self.eeprom[row.address : row.end] = self.image[row.address : row.end]
            self.eeprom_writes += 1


def _make_getter(image: bytearray, row: SimulatedRegister) -> Callable[[], int]:
    """Make a function that reads the value of a register, fast for the common single byte."""
    if row.size == 1 and row.sign is Sign.NONE:
        return partial(image.__getitem__, row.address)
    letter = {1: "b", 2: "h", 4: "i"}[row.size]
    form = ("<" if row.order == "little" else ">") + (letter if row.twos else letter.upper())
    unpack = partial(Struct(form).unpack_from, image, row.address)
    sign_bit = row.sign_bit

    def plain() -> int:
        value: int = unpack()[0]
        return value

    def signed() -> int:
        value: int = unpack()[0]
        magnitude = value & (sign_bit - 1)
        return -magnitude if value & sign_bit else magnitude

    return signed if sign_bit else plain
