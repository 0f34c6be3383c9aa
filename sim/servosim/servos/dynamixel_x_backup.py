"""Control table backup of Dynamixel X: RAM values kept in flash (instruction 0x20)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from servosim.protocol import Refusal
from servosim.tables import Area

if TYPE_CHECKING:
    from servosim.servos.dynamixel_x import DynamixelX

__all__ = ["Backup"]


class Backup:
    """The kept copy of one servo's writable RAM; goals and torque are not part of it."""

    def __init__(self, servo: DynamixelX) -> None:
        self.servo = servo
        self._rows = [
            row
            for row in servo.table.registers
            if row.area is Area.RAM
            and row.writable
            and not row.name.startswith(("goal_", "torque_", "indirect_data_"))
        ]
        self._kept: dict[str, int] | None = None

    @property
    def ready(self) -> bool:
        """Whether there is something to restore."""
        return self._kept is not None

    def store(self) -> Refusal | None:
        """Keep the present values."""
        if self.servo.drive.torque_on:
            return Refusal.RESULT_FAIL
        self._kept = {row.name: self.servo.memory.get(row.name) for row in self._rows}
        return None

    def restore(self) -> Refusal | None:
        """Put the kept values back."""
        if self._kept is None or self.servo.drive.torque_on:
            return Refusal.RESULT_FAIL
        for name, value in self._kept.items():
            self.servo.memory.put(name, value)
        self.servo.orders.set_gains()
        self.servo.orders.note_profile()
        return None
