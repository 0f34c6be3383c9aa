"""A register of a control table: address, access, unit, and encoding of its number."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import Literal, Protocol

from ikservo.registers.units import Unit


class Codec(Protocol):
    """Encoding of a number as an unsigned word in memory."""

    def to_word(self, number: int, size: int) -> int:
        """Encode ``number`` as a word of ``size`` bytes."""
        ...

    def to_number(self, word: int, size: int) -> int:
        """Decode the number that a word of ``size`` bytes encodes."""
        ...

    def span(self, size: int) -> tuple[int, int]:
        """Return the lowest and highest numbers that a word of ``size`` bytes can encode."""
        ...


@dataclass(frozen=True, slots=True)
class Unsigned:
    """Encoding of non-negative numbers, in which the word equals the number."""

    def to_word(self, number: int, size: int) -> int:
        """Return the number itself."""
        return number

    def to_number(self, word: int, size: int) -> int:
        """Return the word itself."""
        return word

    def span(self, size: int) -> tuple[int, int]:
        """Return 0 and the number with all bits set."""
        return 0, (1 << 8 * size) - 1


@dataclass(frozen=True, slots=True)
class TwosComplement:
    """Encoding of Dynamixel protocol 2.0, in which the highest bit has negative weight."""

    def to_word(self, number: int, size: int) -> int:
        """Compute the word: the number modulo ``2 ** (8 * size)``."""
        return number & (1 << 8 * size) - 1

    def to_number(self, word: int, size: int) -> int:
        """Compute the number: the word, minus its span if the highest bit is set."""
        return word - (1 << 8 * size) if word >> 8 * size - 1 else word

    def span(self, size: int) -> tuple[int, int]:
        """Return the lowest and highest two's complement numbers."""
        half = 1 << 8 * size - 1
        return -half, half - 1


@dataclass(frozen=True, slots=True)
class SignMagnitude:
    """Encoding of Feetech: one bit is the direction, and the bits below it are the magnitude.

    Attributes:
        bit: The number of the direction bit; it differs from register to register.
    """

    bit: int

    def to_word(self, number: int, size: int) -> int:
        """Compute the word: the magnitude, with the direction bit if the number is negative."""
        return 1 << self.bit | -number if number < 0 else number

    def to_number(self, word: int, size: int) -> int:
        """Compute the number: the bits below the direction bit, negated if that bit is set."""
        magnitude = word & (1 << self.bit) - 1
        return -magnitude if word >> self.bit & 1 else magnitude

    def span(self, size: int) -> tuple[int, int]:
        """Return a span that is symmetric about zero; zero itself has two words."""
        highest = (1 << self.bit) - 1
        return -highest, highest


ByteOrder = Literal["little", "big"]


class Access(Enum):
    """Whether a register can only be read, or also written."""

    RO = "read-only"
    RW = "read and write"


class Area(Enum):
    """The memory area of a register, which decides whether it survives loss of power."""

    EEPROM = "EEPROM"
    RAM = "RAM"


@dataclass(frozen=True, slots=True, eq=False)
class Register:
    """A row of the control table in the data sheet.

    The content has three notations: ``bytes`` as transmitted; ``raw``, the signed integer in the
    data sheet (ticks, tenths of a volt); and ``value``, the quantity in the register's unit.
    Registers are compared by identity.

    Attributes:
        address: The address of the first byte.
        size: Number of bytes.
        codec: The encoding of the number.
        unit: The quantity of one count.
        access: Whether the register can be written.
        area: EEPROM or RAM.
        lower: Lowest raw number that may be written; by default the lowest possible.
        upper: Highest raw number that may be written.
        name: The vendor's English name in snake_case, taken from the table's attribute.
        byte_order: The byte order, taken from the table of the register.
        range: The lowest and highest raw numbers that may be written.
    """

    address: int
    size: int
    codec: Codec
    unit: Unit
    access: Access
    area: Area
    lower: int | None = None
    upper: int | None = None
    name: str = field(default="", kw_only=True)
    byte_order: ByteOrder = field(default="little", kw_only=True)
    range: tuple[int, int] = field(init=False)

    def __post_init__(self) -> None:
        lowest, highest = self.codec.span(self.size)
        lower = lowest if self.lower is None else self.lower
        upper = highest if self.upper is None else self.upper
        object.__setattr__(self, "range", (lower, upper))

    def __set_name__(self, owner: type, name: str) -> None:
        if self.name:
            return  # a second name in the same table is an alias
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "byte_order", getattr(owner, "byte_order", "little"))

    @property
    def end(self) -> int:
        """The first address after the register."""
        return self.address + self.size

    @property
    def is_writable(self) -> bool:
        """Whether the register can be written."""
        return self.access is Access.RW

    @property
    def steady(self) -> bool:
        """Whether the register changes only when it is written, so that two readings must agree."""
        return self.access is Access.RW or self.area is Area.EEPROM

    def encode(self, raw: int) -> bytes:
        """Encode the bytes of a raw number."""
        return self.codec.to_word(raw, self.size).to_bytes(self.size, self.byte_order)

    def decode(self, data: bytes) -> int:
        """Decode the raw number in ``size`` bytes."""
        return self.codec.to_number(int.from_bytes(data, self.byte_order), self.size)

    def to_value(self, raw: int) -> float:
        """Convert to the quantity in the register's unit."""
        return self.unit.to_value(raw)

    def to_raw(self, value: float) -> int:
        """Convert to the raw number nearest to a quantity in the register's unit."""
        return self.unit.to_raw(value)

    def __str__(self) -> str:
        return self.name or f"register {self.address}"
