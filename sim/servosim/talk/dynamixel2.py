"""Instructions of Dynamixel protocol 2.0 (e-manual, "protocol 2.0, instruction details")."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from servosim.frames import Frame, crc16, encode2
from servosim.frames.dynamixel2 import HEADER
from servosim.servo import Refusal, Servo
from servosim.servos.dynamixel_x import DynamixelX
from servosim.tables import Area
from servosim.talk.turn import BROADCAST, Reply, Turn, one_turn

__all__ = ["answer"]

PING, READ, WRITE, REG_WRITE, ACTION, FACTORY_RESET, REBOOT = 1, 2, 3, 4, 5, 6, 8
CLEAR, BACKUP, STATUS = 0x10, 0x20, 0x55
SYNC_READ, SYNC_WRITE, FAST_SYNC_READ = 0x82, 0x83, 0x8A
BULK_READ, BULK_WRITE, FAST_BULK_READ = 0x92, 0x93, 0x9A

_ERRORS = {
    Refusal.RESULT_FAIL: 1,
    Refusal.INSTRUCTION: 2,
    Refusal.RANGE: 4,
    Refusal.LENGTH: 5,
    Refusal.LIMIT: 6,
    Refusal.ACCESS: 7,
}
_Outcome = bytes | Refusal | None
_Request = tuple[int, int, int]  # id, address, length


def answer(frame: Frame, servos: Sequence[Servo]) -> list[Turn]:
    """Let the servos do what a frame asks; return who answers in which order."""
    for servo in servos:
        servo.heard_s = servo.time_s
    if frame.instruction == STATUS:
        return []
    if frame.instruction in _TO_MANY:
        return _TO_MANY[frame.instruction](frame.params, servos)
    if frame.id == BROADCAST:
        return _to_all(frame, servos)
    return _to_one(frame, servos)


def _to_one(frame: Frame, servos: Sequence[Servo]) -> list[Turn]:
    replies: list[Reply] = []
    for servo in servos:
        if servo.id == frame.id:
            level = _LEVELS.get(frame.instruction, 2)
            outcome = _perform(frame, servo)
            if servo.status_level >= level:
                replies.append(Reply(servo, _status(frame.id, servo, outcome)))
        elif servo.secondary_id == frame.id:
            _obey_as_shadow(frame, servo)
    return one_turn(replies)


def _to_all(frame: Frame, servos: Sequence[Servo]) -> list[Turn]:
    if frame.instruction == PING:
        return [_ping_turn(servo) for servo in sorted(servos, key=lambda servo: servo.id)]
    if frame.instruction != READ and (frame.instruction, frame.params) != (FACTORY_RESET, b"\xff"):
        for servo in servos:
            _perform(frame, servo)
    return []


def _ping_turn(servo: Servo) -> Turn:
    return Turn((Reply(servo, _status(servo.id, servo, _ping(servo, b""))),), slot=servo.id)


def _perform(frame: Frame, servo: Servo) -> _Outcome:
    perform = _TO_ONE.get(frame.instruction)
    return perform(servo, frame.params) if perform else Refusal.INSTRUCTION


def _obey_as_shadow(frame: Frame, servo: Servo) -> None:
    """A secondary id takes instructions, but neither reads nor writes to EEPROM."""
    writes = frame.instruction in (WRITE, REG_WRITE)
    allowed = writes and not _touches_eeprom(servo, frame.params)
    if allowed or frame.instruction in (ACTION, REBOOT, CLEAR):
        _perform(frame, servo)


def _touches_eeprom(servo: Servo, params: bytes) -> bool:
    rows = servo.table.covered(_word(params, 0), len(params) - 2)
    return any(row.area is Area.EEPROM for row in rows)


def _status(id_: int, servo: Servo, outcome: _Outcome) -> bytes:
    error = _ERRORS[outcome] if isinstance(outcome, Refusal) else 0
    data = outcome if isinstance(outcome, bytes) else b""
    return encode2(id_, STATUS, bytes((error | servo.alarm,)) + data)


# One servo.


def _ping(servo: Servo, _: bytes) -> _Outcome:
    return servo.table.number.to_bytes(2, "little") + bytes((servo.memory.get("firmware_version"),))


def _read(servo: Servo, params: bytes) -> _Outcome:
    if len(params) != 4:
        return Refusal.LENGTH
    address, length = _word(params, 0), _word(params, 2)
    if length == 0 or address + length > servo.table.size:
        return Refusal.ACCESS
    return servo.read_bytes(address, length)


def _write(servo: Servo, params: bytes) -> _Outcome:
    if len(params) < 3:
        return Refusal.LENGTH
    return servo.write_bytes(_word(params, 0), params[2:])


def _reg_write(servo: Servo, params: bytes) -> _Outcome:
    if len(params) < 3:
        return Refusal.LENGTH
    return servo.register(_word(params, 0), params[2:])


def _action(servo: Servo, _: bytes) -> _Outcome:
    return servo.act()


def _factory_reset(servo: Servo, params: bytes) -> _Outcome:
    keep = {b"\xff": (), b"\x01": ("id",), b"\x02": ("id", "baud_rate")}.get(params)
    if keep is None:
        return Refusal.RANGE
    servo.factory_reset(keep)
    return None


def _reboot(servo: Servo, _: bytes) -> _Outcome:
    servo.reboot()
    return None


def _clear(servo: Servo, params: bytes) -> _Outcome:
    if params != b"\x01DXL\x22" or not isinstance(servo, DynamixelX):
        return Refusal.RANGE
    if servo.motor.moving:
        return Refusal.RESULT_FAIL
    servo.forget_turns()
    servo.renew_goals()
    return None


def _backup(servo: Servo, params: bytes) -> _Outcome:
    if params[1:] != b"CTRL" or params[0] not in (1, 2) or not isinstance(servo, DynamixelX):
        return Refusal.RANGE
    return servo.backup.store() if params[0] == 1 else servo.backup.restore()


_TO_ONE: dict[int, Callable[[Servo, bytes], _Outcome]] = {
    PING: _ping,
    READ: _read,
    WRITE: _write,
    REG_WRITE: _reg_write,
    ACTION: _action,
    FACTORY_RESET: _factory_reset,
    REBOOT: _reboot,
    CLEAR: _clear,
    BACKUP: _backup,
}
_LEVELS = {PING: 0, READ: 1}


# Many servos.


def _sync_read(params: bytes, servos: Sequence[Servo]) -> list[Turn]:
    return [_read_turn(request, servos) for request in _sync_requests(params)]


def _bulk_read(params: bytes, servos: Sequence[Servo]) -> list[Turn]:
    return [_read_turn(request, servos) for request in _bulk_requests(params)]


def _fast_sync_read(params: bytes, servos: Sequence[Servo]) -> list[Turn]:
    return _fast_turns(list(_sync_requests(params)), servos)


def _fast_bulk_read(params: bytes, servos: Sequence[Servo]) -> list[Turn]:
    return _fast_turns(list(_bulk_requests(params)), servos)


def _sync_write(params: bytes, servos: Sequence[Servo]) -> list[Turn]:
    if len(params) < 4:
        return []
    head, length = params[:2], _word(params, 2)
    for at in range(4, len(params) - length, length + 1):
        _write_to(params[at], head + params[at + 1 : at + 1 + length], servos)
    return []


def _bulk_write(params: bytes, servos: Sequence[Servo]) -> list[Turn]:
    at = 0
    while at + 5 <= len(params):
        length = _word(params, at + 3)
        data = params[at + 5 : at + 5 + length]
        if len(data) == length:
            _write_to(params[at], params[at + 1 : at + 3] + data, servos)
        at += 5 + length
    return []


def _write_to(id_: int, params: bytes, servos: Sequence[Servo]) -> None:
    for servo in servos:
        shadow = servo.secondary_id == id_ and not _touches_eeprom(servo, params)
        if servo.id == id_ or shadow:
            _write(servo, params)


def _sync_requests(params: bytes) -> Iterator[_Request]:
    if len(params) >= 4:
        address, length = _word(params, 0), _word(params, 2)
        for id_ in params[4:]:
            yield id_, address, length


def _bulk_requests(params: bytes) -> Iterator[_Request]:
    for at in range(0, len(params) - 4, 5):
        yield params[at], _word(params, at + 1), _word(params, at + 3)


def _read_turn(request: _Request, servos: Sequence[Servo]) -> Turn:
    id_, address, length = request
    asked = address.to_bytes(2, "little") + length.to_bytes(2, "little")
    replies = tuple(
        Reply(servo, _status(id_, servo, _read(servo, asked)))
        for servo in servos
        if servo.id == id_ and servo.status_level >= 1
    )
    return Turn(replies, size=11 + length)


def _fast_turns(requests: list[_Request], servos: Sequence[Servo]) -> list[Turn]:
    """One status packet in shares; the chain breaks at the first servo that is missing."""
    length = 1 + sum(4 + request[2] for request in requests)
    so_far = HEADER + bytes((BROADCAST, length & 0xFF, length >> 8, STATUS))
    turns: list[Turn] = []
    for id_, address, size in requests:
        there = [servo for servo in servos if servo.id == id_ and servo.status_level >= 1]
        if not there or address + size > there[0].table.size:
            break
        share = bytes((there[0].alarm, id_)) + there[0].read_bytes(address, size)
        crc = crc16(so_far + share).to_bytes(2, "little")
        data = (b"" if turns else so_far) + share + crc
        turns.append(Turn(tuple(Reply(servo, data) for servo in there), prompt=bool(turns)))
        so_far += share + crc
    return turns


_TO_MANY: dict[int, Callable[[bytes, Sequence[Servo]], list[Turn]]] = {
    SYNC_READ: _sync_read,
    SYNC_WRITE: _sync_write,
    FAST_SYNC_READ: _fast_sync_read,
    BULK_READ: _bulk_read,
    BULK_WRITE: _bulk_write,
    FAST_BULK_READ: _fast_bulk_read,
}


def _word(params: bytes, at: int) -> int:
    return int.from_bytes(params[at : at + 2], "little")
