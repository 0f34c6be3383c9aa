"""What one servo does with an instruction of Dynamixel protocol 2.0."""

from __future__ import annotations

from collections.abc import Callable

from servosim.frames import encode2
from servosim.protocol import Refusal
from servosim.servo import Servo
from servosim.servos.dynamixel_x import DynamixelX
from servosim.tables import Area

__all__ = [
    "LEVELS",
    "Outcome",
    "perform",
    "ping",
    "read_at",
    "status",
    "touches_eeprom",
    "word",
    "write",
]

PING, READ, WRITE, REG_WRITE, ACTION, FACTORY_RESET, REBOOT = 1, 2, 3, 4, 5, 6, 8
CLEAR, BACKUP, STATUS = 0x10, 0x20, 0x55

LEVELS = {PING: 0, READ: 1}  # status return level from which an instruction is answered; else 2

_ERRORS = {
    Refusal.RESULT_FAIL: 1,
    Refusal.INSTRUCTION: 2,
    Refusal.RANGE: 4,
    Refusal.LENGTH: 5,
    Refusal.LIMIT: 6,
    Refusal.ACCESS: 7,
}
Outcome = bytes | Refusal | None


def perform(instruction: int, params: bytes, servo: Servo) -> Outcome:
    """Let a servo do what an instruction asks; return its data, or why it refuses."""
    do = _TO_ONE.get(instruction)
    return do(servo, params) if do else Refusal.INSTRUCTION


def status(id_: int, servo: Servo, outcome: Outcome) -> bytes:
    """Return the status packet of an outcome."""
    error = _ERRORS[outcome] if isinstance(outcome, Refusal) else 0
    data = outcome if isinstance(outcome, bytes) else b""
    return encode2(id_, STATUS, bytes((error | servo.alarm,)) + data)


def touches_eeprom(servo: Servo, params: bytes) -> bool:
    """Say whether a write's parameters reach into the EEPROM."""
    rows = servo.table.covered(word(params, 0), len(params) - 2)
    return any(row.area is Area.EEPROM for row in rows)


def word(params: bytes, at: int) -> int:
    """Return the 16-bit number at a place."""
    return int.from_bytes(params[at : at + 2], "little")


def ping(servo: Servo, _: bytes = b"") -> Outcome:
    """Model number and firmware version."""
    return servo.table.number.to_bytes(2, "little") + bytes((servo.memory.get("firmware_version"),))


def read(servo: Servo, params: bytes) -> Outcome:
    """Address and length: the bytes there."""
    if len(params) != 4:
        return Refusal.LENGTH
    return read_at(servo, word(params, 0), word(params, 2))


def read_at(servo: Servo, address: int, length: int) -> Outcome:
    """The bytes at an address, if all of them are inside the memory."""
    if length == 0 or address + length > servo.table.size:
        return Refusal.ACCESS
    return servo.read_bytes(address, length)


def write(servo: Servo, params: bytes) -> Outcome:
    """Address and bytes to store there."""
    if len(params) < 3:
        return Refusal.LENGTH
    return servo.write_bytes(word(params, 0), params[2:])


def _reg_write(servo: Servo, params: bytes) -> Outcome:
    if len(params) < 3:
        return Refusal.LENGTH
    return servo.register(word(params, 0), params[2:])


def _action(servo: Servo, _: bytes) -> Outcome:
    return servo.act()


def _factory_reset(servo: Servo, params: bytes) -> Outcome:
    keep = {b"\xff": (), b"\x01": ("id",), b"\x02": ("id", "baud_rate")}.get(params)
    if keep is None:
        return Refusal.RANGE
    servo.factory_reset(keep)
    return None


def _reboot(servo: Servo, _: bytes) -> Outcome:
    servo.reboot()
    return None


def _clear(servo: Servo, params: bytes) -> Outcome:
    if params != b"\x01DXL\x22" or not isinstance(servo, DynamixelX):
        return Refusal.RANGE
    if servo.motor.moving:
        return Refusal.RESULT_FAIL
    servo.forget_turns()
    servo.renew_goals()
    return None


def _backup(servo: Servo, params: bytes) -> Outcome:
    if params[1:] != b"CTRL" or params[0] not in (1, 2) or not isinstance(servo, DynamixelX):
        return Refusal.RANGE
    return servo.backup.store() if params[0] == 1 else servo.backup.restore()


_TO_ONE: dict[int, Callable[[Servo, bytes], Outcome]] = {
    PING: ping,
    READ: read,
    WRITE: write,
    REG_WRITE: _reg_write,
    ACTION: _action,
    FACTORY_RESET: _factory_reset,
    REBOOT: _reboot,
    CLEAR: _clear,
    BACKUP: _backup,
}
