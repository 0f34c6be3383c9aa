"""How a signed number is written into the bits of a register's word."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

__all__ = ["Codec", "SignMagnitude", "TwosComplement", "Unsigned"]


class Codec(Protocol):
    """Turns a number into the word that stands in memory, and back."""

    def to_word(self, number: int, size: int) -> int:
        """Return the word of ``size`` bytes that stands for ``number``."""
        ...

    def to_number(self, word: int, size: int) -> int:
        """Return the number that a word of ``size`` bytes stands for."""
        ...

    def span(self, size: int) -> tuple[int, int]:
        """Return the least and the greatest number a word of ``size`` bytes can hold."""
        ...


@dataclass(frozen=True, slots=True)
class Unsigned:
    """The word is the number."""

    def to_word(self, number: int, size: int) -> int:
        """Return the number itself."""
        return number

    def to_number(self, word: int, size: int) -> int:
        """Return the word itself."""
        return word

    def span(self, size: int) -> tuple[int, int]:
        """Return 0 and all bits set."""
        return 0, (1 << 8 * size) - 1


@dataclass(frozen=True, slots=True)
class TwosComplement:
    """Dynamixel protocol 2.0: the highest bit of the word weighs negative."""

    def to_word(self, number: int, size: int) -> int:
        """Return the number modulo the word's span."""
        return number & (1 << 8 * size) - 1

    def to_number(self, word: int, size: int) -> int:
        """Return the word, less its span where the highest bit is set."""
        return word - (1 << 8 * size) if word >> 8 * size - 1 else word

    def span(self, size: int) -> tuple[int, int]:
        """Return the one more negative and the positive half."""
        half = 1 << 8 * size - 1
        return -half, half - 1


@dataclass(frozen=True, slots=True)
class SignMagnitude:
    """Feetech: one bit is the direction, the bits below it are the size of the number.

    Attributes:
        bit: The direction bit; which one it is differs from register to register.
    """

    bit: int

    def to_word(self, number: int, size: int) -> int:
        """Return the magnitude, with the direction bit where the number is negative."""
        return 1 << self.bit | -number if number < 0 else number

    def to_number(self, word: int, size: int) -> int:
        """Return the bits below the direction bit, negated where that bit is set."""
        magnitude = word & (1 << self.bit) - 1
        return -magnitude if word >> self.bit & 1 else magnitude

    def span(self, size: int) -> tuple[int, int]:
        """Return the same magnitude to both sides; zero has two words."""
        most = (1 << self.bit) - 1
        return -most, most
