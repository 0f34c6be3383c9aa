"""A servo's memory: bytes at addresses, EEPROM that survives the power and RAM that does not."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from struct import Struct

from servosim.register import ServoTable, SimulatedArea, SimulatedRegister

__all__ = ["Memory"]


class Memory:
    """The bytes behind a control table.

    ``image`` is what instructions read and write; ``eeprom`` is what is still there after the
    power was off. Nothing here checks access: that is the servo's firmware.
    """

    def __init__(self, table: ServoTable, delivered: Mapping[str, int] | None = None) -> None:
        self.table = table
        self._eeprom_end = max(
            row.end for row in table.registers if row.area is SimulatedArea.EEPROM
        )
        self.image = bytearray(table.size)  # one object for ever: the line below holds on to it
        self._rows = {
            row.name: (
                partial(Struct(_struct_format(row)).unpack_from, self.image, row.address),
                row.sign_bit,
            )
            for row in table.registers
        }
        self.eeprom = bytearray(table.size)
        self.eeprom_writes = 0
        self.restore_factory()
        for name, value in (delivered or {}).items():
            self.put(name, value)
            self._persist_register(table.by_name[name])

    def read(self, address: int, length: int) -> bytes:
        """Return bytes; gaps between registers and addresses behind the table read as zero."""
        raw = bytes(self.image[address : address + length])
        return raw if len(raw) == length else raw.ljust(length, b"\x00")

    def get(self, name: str) -> int:
        """Return a register's number."""
        unpack, sign_bit = self._rows[name]
        value: int = unpack()[0]
        if not sign_bit:
            return value
        magnitude = value & (sign_bit - 1)
        return -magnitude if value & sign_bit else magnitude

    def put(self, name: str, value: int) -> None:
        """Set a register as the firmware does: no checks, RAM image only."""
        row = self.table.by_name[name]
        self.image[row.address : row.end] = row.encode(value)

    def persist_value(self, name: str) -> None:
        """Make a register's present number survive the power, lock or not."""
        self._persist_register(self.table.by_name[name])

    def write(self, address: int, data: bytes, *, persist: bool = True) -> None:
        """Store bytes in the image, and those of EEPROM registers for good if ``persist``."""
        self.image[address : address + len(data)] = data
        if persist and address < self._eeprom_end:
            for row in self.table.registers_in(address, len(data)):
                self._persist_register(row)

    def power_cycle(self) -> None:
        """Forget the RAM: defaults for it, the kept bytes for the EEPROM."""
        for row in self.table.registers:
            if row.area is SimulatedArea.EEPROM:
                self.image[row.address : row.end] = self.eeprom[row.address : row.end]
            else:
                self.image[row.address : row.end] = row.encode(row.default)

    def restore_factory(self, keep: tuple[str, ...] = ()) -> None:
        """Set every register to the datasheet's default, except those to keep."""
        for row in self.table.registers:
            if row.name not in keep:
                self.image[row.address : row.end] = row.encode(row.default)
                if row.area is SimulatedArea.EEPROM:
                    self.eeprom[row.address : row.end] = row.encode(row.default)

    def _persist_register(self, row: SimulatedRegister) -> None:
        if row.area is SimulatedArea.EEPROM:
            self.eeprom[row.address : row.end] = self.image[row.address : row.end]
            self.eeprom_writes += 1


def _struct_format(row: SimulatedRegister) -> str:
    letter = {1: "b", 2: "h", 4: "i"}[row.size]
    return ("<" if row.order == "little" else ">") + (letter if row.twos else letter.upper())
