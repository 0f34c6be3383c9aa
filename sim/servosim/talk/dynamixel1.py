"""Instructions of Dynamixel protocol 1.0 and of Feetech servos, which share their frames."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from servosim.frames import Frame, encode1
from servosim.protocol import Protocol, Refusal
from servosim.servo import Servo
from servosim.talk.turn import BROADCAST, Reply, Turn, by_id, one_turn

__all__ = ["answer"]

PING, READ, WRITE, REG_WRITE, ACTION, RECOVERY = 1, 2, 3, 4, 5, 6
REBOOT, RESET_TURNS, CALIBRATE = 0x08, 0x0A, 0x0B
SYNC_READ, SYNC_WRITE, BULK_READ = 0x82, 0x83, 0x92
LONGEST_DATA = 253  # what the length byte of a status can tell

_ERRORS = {Refusal.LIMIT: 0x02, Refusal.RANGE: 0x08, Refusal.INSTRUCTION: 0x40}
_Outcome = bytes | Refusal | None


def answer(frame: Frame, servos: Sequence[Servo]) -> list[Turn]:
    """Let the servos do what a frame asks; return who answers in which order."""
    for servo in servos:
        servo.heard_s = servo.time_s
    if frame.instruction in _TO_MANY:
        return _TO_MANY[frame.instruction](frame.params, servos)
    if frame.id == BROADCAST:
        return _to_all(frame, servos)
    addressed = [servo for servo in servos if servo.id == frame.id]
    return one_turn([reply for servo in addressed for reply in _reply(frame, servo)])


def _reply(frame: Frame, servo: Servo) -> Iterator[Reply]:
    known = frame.instruction in _TO_ONE and frame.instruction in servo.instructions
    if not known and servo.protocol is Protocol.FEETECH:
        return  # assumed: Feetech servos keep silent about what they do not know
    perform = _TO_ONE[frame.instruction] if known else _unknown
    outcome = perform(servo, frame.params)
    if servo.status_level >= _LEVELS.get(frame.instruction, 2):
        yield Reply(servo, _status(frame.id, servo, outcome))


def _to_all(frame: Frame, servos: Sequence[Servo]) -> list[Turn]:
    if frame.instruction == PING:
        answering = [servo for servo in servos if servo.answers_broadcast_ping]
        answering.sort(key=lambda servo: servo.id)
        return [
            Turn((Reply(servo, _status(servo.id, servo, None)),), slot=servo.id)
            for servo in answering
        ]
    if frame.instruction != READ and frame.instruction in _TO_ONE:
        for servo in servos:
            if frame.instruction in servo.instructions:
                _TO_ONE[frame.instruction](servo, frame.params)
    return []


def _status(id_: int, servo: Servo, outcome: _Outcome) -> bytes:
    error = servo.alarm
    if isinstance(outcome, Refusal) and servo.protocol is Protocol.DYNAMIXEL_1:
        error |= _ERRORS.get(outcome, 0x08)
    return encode1(id_, error, outcome if isinstance(outcome, bytes) else b"")


# One servo.


def _ping(_: Servo, __: bytes) -> _Outcome:
    return None


def _read(servo: Servo, params: bytes) -> _Outcome:
    if len(params) != 2 or not 0 < params[1] <= LONGEST_DATA:
        return Refusal.RANGE
    beyond = params[0] + params[1] > servo.table.size
    if beyond and servo.protocol is Protocol.DYNAMIXEL_1:
        return Refusal.RANGE
    return servo.read_bytes(params[0], params[1])


def _write(servo: Servo, params: bytes) -> _Outcome:
    return servo.write_bytes(params[0], params[1:]) if len(params) >= 2 else Refusal.RANGE


def _reg_write(servo: Servo, params: bytes) -> _Outcome:
    return servo.register(params[0], params[1:]) if len(params) >= 2 else Refusal.RANGE


def _action(servo: Servo, _: bytes) -> _Outcome:
    return servo.act()


def _recovery(servo: Servo, _: bytes) -> _Outcome:
    servo.factory_reset(servo.kept_by_recovery)
    return None


def _reboot(servo: Servo, _: bytes) -> _Outcome:
    servo.reboot()
    return None


def _reset_turns(servo: Servo, _: bytes) -> _Outcome:
    servo.forget_turns()
    return None


def _calibrate(servo: Servo, _: bytes) -> _Outcome:
    servo.calibrate()
    return None


def _unknown(_: Servo, __: bytes) -> _Outcome:
    return Refusal.INSTRUCTION


_TO_ONE: dict[int, Callable[[Servo, bytes], _Outcome]] = {
    PING: _ping,
    READ: _read,
    WRITE: _write,
    REG_WRITE: _reg_write,
    ACTION: _action,
    RECOVERY: _recovery,
    REBOOT: _reboot,
    RESET_TURNS: _reset_turns,
    CALIBRATE: _calibrate,
}
_LEVELS = {PING: 0, READ: 1}


# Many servos.


def _sync_read(params: bytes, servos: Sequence[Servo]) -> list[Turn]:
    if len(params) < 3:
        return []
    asked, there = params[:2], by_id(servos)
    return [_read_turn(SYNC_READ, id_, asked, there.get(id_, ())) for id_ in params[2:]]


def _bulk_read(params: bytes, servos: Sequence[Servo]) -> list[Turn]:
    """Length, id, address of each servo, after one zero."""
    groups = [params[at : at + 3] for at in range(1, len(params) - 2, 3)]
    there = by_id(servos)
    return [
        _read_turn(BULK_READ, id_, bytes((address, length)), there.get(id_, ()))
        for length, id_, address in groups
    ]


def _read_turn(instruction: int, id_: int, asked: bytes, servos: Sequence[Servo]) -> Turn:
    replies = tuple(
        Reply(servo, _status(id_, servo, _read(servo, asked)))
        for servo in servos
        if instruction in servo.instructions and servo.status_level >= 1
    )
    return Turn(replies, size=6 + asked[1])


def _sync_write(params: bytes, servos: Sequence[Servo]) -> list[Turn]:
    if len(params) < 2:
        return []
    address, length, there = params[:1], params[1], by_id(servos)
    for at in range(2, len(params) - length, length + 1):
        for servo in there.get(params[at], ()):
            _write(servo, address + params[at + 1 : at + 1 + length])
    return []


_TO_MANY: dict[int, Callable[[bytes, Sequence[Servo]], list[Turn]]] = {
    SYNC_READ: _sync_read,
    SYNC_WRITE: _sync_write,
    BULK_READ: _bulk_read,
}
