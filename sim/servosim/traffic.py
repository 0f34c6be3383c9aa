"""Bus traffic: listeners, log, and audit report."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

from servosim.errors import LogFileError
from servosim.frames import HEADER, Dynamixel2Reader, Frame, FrameReader
from servosim.servo import BusProtocol, Servo


@dataclass(slots=True)
class ServoAudit:
    """Statistics of the instructions to one servo; positions in ticks of its registers.

    Attributes:
        id: The id at the time of the report.
        model: The servo model.
        goals: Number of goal positions written.
        goals_outside_limits: Number of goals outside the servo's own position limits.
        largest_goal_step: Largest step between two successive goals.
        largest_goal_distance: Largest distance of a goal from the present position when written.
        eeprom_writes: Number of permanent writes to registers of the EEPROM.
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
            servo.on_write = self._register_watcher(place)
            servo.memory.eeprom_writes = 0

    def on_frame(self, at_s: float, frame: Frame, framing: type[FrameReader]) -> None:
        """Count a frame of the host."""
        self.frames += 1

    def on_reply(self, at_s: float, servo: Servo | None, data: bytes) -> None:
        """Count a reply."""
        self.replies += 1
        self.collisions += servo is None

    def report(self, readers: list[FrameReader]) -> dict[str, Any]:
        """Return all statistics as plain data."""
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

    def _register_watcher(self, place: int) -> Callable[[int, bytes], None]:
        servo = self._servos[place]
        goal = servo.table.by_name["goal_position"]

        def watch(address: int, data: bytes) -> None:
            start = goal.address - address
            if start >= 0 and start + goal.size <= len(data):
                self._record_goal(place, goal.decode(data[start : start + goal.size]))

        return watch

    def _record_goal(self, place: int, goal: int) -> None:
        servo, record, last = self._servos[place], self._records[place], self._last[place]
        record.goals += 1
        record.goals_outside_limits += not servo.is_goal_allowed(goal)
        distance = abs(goal - servo.read("present_position"))
        record.largest_goal_distance = max(record.largest_goal_distance, distance)
        if last is not None:
            record.largest_goal_step = max(record.largest_goal_step, abs(goal - last))
        self._last[place] = goal


_INSTRUCTIONS = {
    0x01: "ping",
    0x02: "read",
    0x03: "write",
    0x04: "registered write",
    0x05: "action",
    0x06: "factory reset",
    0x08: "reboot",
    0x0A: "reset turns",
    0x0B: "calibrate",
    0x10: "clear",
    0x20: "backup",
    0x82: "sync read",
    0x83: "sync write",
    0x8A: "fast sync read",
    0x92: "bulk read",
    0x93: "bulk write",
    0x9A: "fast bulk read",
}
_ADDRESSED = {0x02, 0x03, 0x04, 0x82, 0x83, 0x8A}


class TrafficLog:
    """Writes each frame to a file: ``seconds  > or <  bytes  meaning``."""

    def __init__(self, path: Path, servos: tuple[Servo, ...]) -> None:
        self._path = path
        try:
            self._file = path.open("w", encoding="utf-8", buffering=1)
        except OSError as error:
            raise LogFileError(path, error) from error
        self._servos = servos

    def on_frame(self, at_s: float, frame: Frame, framing: type[FrameReader]) -> None:
        """Log a frame of the host."""
        wide = framing is Dynamixel2Reader
        name = _INSTRUCTIONS.get(frame.instruction, f"instruction 0x{frame.instruction:02X}")
        to = "all" if frame.id == 0xFE else str(frame.id)
        self._write_line(
            at_s, ">", frame.raw, f"{name} {to}{self._describe_register(frame, wide=wide)}"
        )

    def on_reply(self, at_s: float, servo: Servo | None, data: bytes) -> None:
        """Log a reply of a servo."""
        if servo is None:
            meaning = "collision"
        else:
            error = _status_error(servo, data)
            meaning = f"status {servo.id}" + (f" error 0x{error:02X}" if error else "")
        self._write_line(at_s, "<", data, meaning)

    def close(self) -> None:
        """Close the file."""
        with contextlib.suppress(OSError):  # a line that cannot be written was already reported
            self._file.close()

    def _write_line(self, at_s: float, arrow: str, raw: bytes, meaning: str) -> None:
        try:
            self._file.write(f"{at_s:12.6f} {arrow} {raw.hex(' ').upper()}  {meaning}\n")
        except OSError as error:
            raise LogFileError(self._path, error) from error

    def _describe_register(self, frame: Frame, *, wide: bool) -> str:
        """Describe the register of an instruction."""
        size = 2 if wide else 1
        if frame.instruction not in _ADDRESSED or len(frame.params) < size:
            return ""
        address = int.from_bytes(frame.params[:size], "little")
        for servo in self._servos:
            if frame.id in (servo.id, 0xFE) and address < servo.table.size:
                row = servo.table.by_byte[address]
                return f" {row.name} ({address})" if row else f" ({address})"
        return f" ({address})"


def _status_error(servo: Servo, data: bytes) -> int:
    """Return the error byte of a status packet.

    The second and later servos of a fast read send no header: their part of the common packet
    begins with the error byte (e-manual, protocol 2.0, "Fast Sync Read").
    """
    if servo.protocol is not BusProtocol.DYNAMIXEL_2:
        return data[4]
    return data[8] if data.startswith(HEADER) else data[0]


class FrameListener(Protocol):
    """A passive listener on the line."""

    def on_frame(self, at_s: float, frame: Frame, framing: type[FrameReader]) -> None:
        """Receive a frame of the host."""
        ...

    def on_reply(self, at_s: float, servo: Servo | None, data: bytes) -> None:
        """Receive a reply that starts; servo is None if several collide."""
        ...
