"""Access rules of the Dynamixel X memory: what may be written when, and indirect registers."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from servosim.protocol import Refusal
from servosim.tables import Area, Register

if TYPE_CHECKING:
    from servosim.servos.dynamixel_x import DynamixelX

__all__ = ["Rules"]

_LIMIT_OF = {
    "goal_pwm": "pwm_limit",
    "goal_current": "current_limit",
    "goal_velocity": "velocity_limit",
}
_GOALS = frozenset((*_LIMIT_OF, "goal_position"))


class Rules:
    """Judges writes to one servo's memory.

    Attributes:
        first_data: Where indirect data begin; below it no address is indirect.
    """

    def __init__(self, servo: DynamixelX) -> None:
        self.servo = servo
        self.memory, self.table = servo.memory, servo.table
        names = self.table.by_name
        self._data = {
            row.address: names[
                "indirect_address_" + row.name.removeprefix("indirect_data_")
            ].address
            for row in self.table.registers
            if row.name.startswith("indirect_data_")
        }
        self.first_data = min(self._data)

    def refusal(self, address: int, data: bytes) -> Refusal | None:
        """Return why a write is refused; runs through indirect data are judged where they land."""
        if address + len(data) <= self.first_data:
            return self._direct(address, data)
        for start, part in self._runs(address, data):
            refusal = self._direct(start, part)
            if refusal is not None:
                return refusal
        return None

    def read(self, address: int, length: int, read: Callable[[int, int], bytes]) -> bytes:
        """Read, following indirect addresses."""
        return b"".join(read(self._target(at), 1) for at in range(address, address + length))

    def store(self, address: int, data: bytes, store: Callable[[int, bytes], None]) -> None:
        """Store, following indirect addresses."""
        for start, part in self._runs(address, data):
            store(start, part)

    def _target(self, address: int) -> int:
        at = self._data.get(address)
        if at is None:
            return address
        return int.from_bytes(self.memory.image[at : at + 2], "little")

    def _runs(self, address: int, data: bytes) -> list[tuple[int, bytes]]:
        """Split a write into runs of neighbouring bytes, indirect addresses followed."""
        runs: list[tuple[int, bytes]] = []
        for k in range(len(data)):
            target = self._target(address + k)
            if runs and runs[-1][0] + len(runs[-1][1]) == target:
                runs[-1] = (runs[-1][0], runs[-1][1] + data[k : k + 1])
            else:
                runs.append((target, data[k : k + 1]))
        return runs

    def _direct(self, address: int, data: bytes) -> Refusal | None:
        end = address + len(data)
        if not self.table.gapless(address, len(data)):
            return Refusal.ACCESS
        rows = self.table.covered(address, len(data))
        if rows[0].address < address or rows[-1].end > end:
            return Refusal.LENGTH
        for row in rows:
            value = row.decode(data[row.address - address : row.end - address])
            refusal = self._access(row) or self._value(row, value)
            if refusal is not None:
                return refusal
        return None

    def _access(self, row: Register) -> Refusal | None:
        if not row.writable or (row.area is Area.EEPROM and self.memory.get("torque_enable")):
            return Refusal.ACCESS
        if row.name in _GOALS and self.memory.get("bus_watchdog") == -1:
            return Refusal.RANGE
        if row.name == "torque_enable" and self.servo.watch.shut_down:
            return Refusal.RESULT_FAIL
        return None

    def _value(self, row: Register, value: int) -> Refusal | None:
        lower, upper = self._range(row)
        if row.name == "operating_mode":
            return None if value in self.servo.modes else Refusal.RANGE
        return None if lower <= value <= upper else Refusal.RANGE

    def _range(self, row: Register) -> tuple[int, int]:
        get = self.memory.get
        if row.name == "goal_position" and self.servo.mode == 3:
            return get("min_position_limit"), get("max_position_limit")
        limit = _LIMIT_OF.get(row.name)
        return (-get(limit), get(limit)) if limit else (row.lower, row.upper)
