"""The audit: what the host asked of the servos, for a report at the end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from servosim.frames import Frame, FrameReader
from servosim.servo import Servo

__all__ = ["Audit"]


@dataclass(slots=True)
class ServoAudit:
    """What was asked of one servo; positions in ticks of its registers.

    Attributes:
        id: At the time of the report.
        model: Of the servo.
        goals: Goal positions written.
        goals_outside_limits: Of these, outside the servo's own position limits.
        largest_goal_step: Between two goals that followed each other.
        largest_goal_distance: From a goal to the present position when it was written.
        eeprom_writes: Registers of the EEPROM that were written for good.
    """

    id: int
    model: str
    goals: int = 0
    goals_outside_limits: int = 0
    largest_goal_step: int = 0
    largest_goal_distance: int = 0
    eeprom_writes: int = 0


class Audit:
    """Counts frames and watches the goals that the host writes."""

    def __init__(self, servos: tuple[Servo, ...]) -> None:
        self.frames = self.replies = self.collisions = 0
        self._servos = servos
        self._records = [ServoAudit(servo.id, servo.table.model) for servo in servos]
        self._last: list[int | None] = [None] * len(servos)
        for place, servo in enumerate(servos):
            servo.asked = self._watcher(place)
            servo.memory.eeprom_writes = 0

    def heard(self, at_s: float, frame: Frame, framing: type[FrameReader]) -> None:
        """Count a frame of the host."""
        self.frames += 1

    def said(self, at_s: float, servo: Servo | None, data: bytes) -> None:
        """Count an answer."""
        self.replies += 1
        self.collisions += servo is None

    def report(self, readers: list[FrameReader]) -> dict[str, Any]:
        """Return everything as plain data."""
        for record, servo in zip(self._records, self._servos, strict=True):
            record.id, record.eeprom_writes = servo.id, servo.memory.eeprom_writes
        return {
            "schema": "servosim/audit/1",
            "frames": self.frames,
            "replies": self.replies,
            "collisions": self.collisions,
            "bad_checksums": sum(reader.bad_checksums for reader in readers),
            "junk_bytes": sum(reader.junk_bytes for reader in readers),
            "servos": [asdict(record) for record in self._records],
        }

    def _watcher(self, place: int) -> Callable[[int, bytes], None]:
        servo = self._servos[place]
        goal = servo.table.by_name["goal_position"]

        def watch(address: int, data: bytes) -> None:
            start = goal.address - address
            if start >= 0 and start + goal.size <= len(data):
                self._see_goal(place, goal.decode(data[start : start + goal.size]))

        return watch

    def _see_goal(self, place: int, goal: int) -> None:
        servo, record, last = self._servos[place], self._records[place], self._last[place]
        record.goals += 1
        record.goals_outside_limits += not servo.allows(goal)
        distance = abs(goal - servo.read("present_position"))
        record.largest_goal_distance = max(record.largest_goal_distance, distance)
        if last is not None:
            record.largest_goal_step = max(record.largest_goal_step, abs(goal - last))
        self._last[place] = goal
