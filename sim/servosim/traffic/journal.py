"""The log: one line a frame, with time, direction, bytes and what they mean."""

from __future__ import annotations

from pathlib import Path

from servosim.frames import Dynamixel2Reader, Frame, FrameReader
from servosim.protocol import Protocol
from servosim.servo import Servo

__all__ = ["Journal"]

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


class Journal:
    """Writes each frame to a file: ``seconds  > or <  bytes  meaning``."""

    def __init__(self, path: Path, servos: tuple[Servo, ...]) -> None:
        self._file = path.open("w", encoding="utf-8", buffering=1)
        self._servos = servos

    def heard(self, at_s: float, frame: Frame, framing: type[FrameReader]) -> None:
        """Write down what the host says."""
        wide = framing is Dynamixel2Reader
        name = _INSTRUCTIONS.get(frame.instruction, f"instruction 0x{frame.instruction:02X}")
        to = "all" if frame.id == 0xFE else str(frame.id)
        self._line(at_s, ">", frame.raw, f"{name} {to}{self._where(frame, wide=wide)}")

    def said(self, at_s: float, servo: Servo | None, data: bytes) -> None:
        """Write down what a servo answers."""
        if servo is None:
            meaning = "collision"
        else:
            error = data[8] if servo.protocol is Protocol.DYNAMIXEL_2 else data[4]
            meaning = f"status {servo.id}" + (f" error 0x{error:02X}" if error else "")
        self._line(at_s, "<", data, meaning)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _line(self, at_s: float, arrow: str, raw: bytes, meaning: str) -> None:
        self._file.write(f"{at_s:12.6f} {arrow} {raw.hex(' ').upper()}  {meaning}\n")

    def _where(self, frame: Frame, *, wide: bool) -> str:
        """Say which register an instruction is about."""
        size = 2 if wide else 1
        if frame.instruction not in _ADDRESSED or len(frame.params) < size:
            return ""
        address = int.from_bytes(frame.params[:size], "little")
        for servo in self._servos:
            if frame.id in (servo.id, 0xFE) and address < servo.table.size:
                row = servo.table.by_byte[address]
                return f" {row.name} ({address})" if row else f" ({address})"
        return f" ({address})"
