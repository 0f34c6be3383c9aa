"""One register of a servo: where it stands, how it is written, what it means."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import Literal

from ikservo.registers.codec import Codec
from ikservo.registers.units import Unit

__all__ = ["Access", "Area", "ByteOrder", "Register"]

ByteOrder = Literal["little", "big"]


class Access(Enum):
    """Who may change a register."""

    RO = "read-only"
    RW = "read and write"


class Area(Enum):
    """Whether a register survives loss of power."""

    EEPROM = "EEPROM"
    RAM = "RAM"


@dataclass(frozen=True, slots=True, eq=False)
class Register:
    """A row of the datasheet's control table.

    Three notations of one content: ``bytes`` as on the line, ``raw`` the signed integer of the
    datasheet (ticks, tenths of a volt), ``value`` the quantity in the register's unit. Each row
    is itself and equal to no other.

    Attributes:
        address: First byte.
        size: Bytes.
        codec: How a signed number stands in the word.
        unit: What one count is worth.
        access: Whether it can be written.
        area: EEPROM or RAM.
        lower: Least raw number that may be written; by default the least that fits.
        upper: Greatest raw number that may be written.
        name: The vendor's English name in snake_case, taken from the table's attribute.
        byte_order: Taken from the table that holds the register.
        range: The least and the greatest raw number that may be written.
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
        least, most = self.codec.span(self.size)
        lower = least if self.lower is None else self.lower
        upper = most if self.upper is None else self.upper
        object.__setattr__(self, "range", (lower, upper))

    def __set_name__(self, owner: type, name: str) -> None:
        if self.name:
            return  # a second name in the same table is an alias
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "byte_order", getattr(owner, "byte_order", "little"))

    @property
    def end(self) -> int:
        """Return the first address behind the register."""
        return self.address + self.size

    @property
    def steady(self) -> bool:
        """Whether it changes only when it is written, so that two readings must agree."""
        return self.access is Access.RW or self.area is Area.EEPROM

    def encode(self, raw: int) -> bytes:
        """Return the bytes that stand for a raw number."""
        return self.codec.to_word(raw, self.size).to_bytes(self.size, self.byte_order)

    def decode(self, data: bytes) -> int:
        """Return the raw number that ``size`` bytes stand for."""
        return self.codec.to_number(int.from_bytes(data, self.byte_order), self.size)

    def to_value(self, raw: int) -> float:
        """Return the quantity in the register's unit."""
        return self.unit.to_value(raw)

    def to_raw(self, value: float) -> int:
        """Return the raw number nearest to a quantity in the register's unit."""
        return self.unit.to_raw(value)

    def __str__(self) -> str:
        return self.name or f"register {self.address}"
