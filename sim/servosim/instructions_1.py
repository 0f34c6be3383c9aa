"""Instructions of protocol 1.0 and of Feetech servos."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from servosim.frames import Frame, encode1
from servosim.servo import BusProtocol, InstructionError, Servo

BROADCAST = 0xFE


class Reply(NamedTuple):
    """Bytes that a servo sends."""

    servo: Servo
    data: bytes


class ReplySlot(NamedTuple):
    """A place in the order of replies.

    Attributes:
        replies: The replies in this place; if there is more than one, they collide.
        size: Number of bytes for which the next slot waits if there is no reply.
        slot: A fixed place counted in packets from the instruction (broadcast ping), or None to
            follow the previous place.
        prompt: True to follow the previous place without a return delay (fast reads).
    """

    replies: tuple[Reply, ...]
    size: int = 0
    slot: int | None = None
    prompt: bool = False


def servos_by_id(servos: Sequence[Servo]) -> dict[int, list[Servo]]:
    """Return the servos at each id."""
    found: dict[int, list[Servo]] = {}
    for servo in servos:
        found.setdefault(servo.id, []).append(servo)
    return found


def single_slot(replies: list[Reply]) -> list[ReplySlot]:
    """Return the reply slot of an instruction to one id: all servos with that id reply at once."""
    return [ReplySlot(tuple(replies))] if replies else []


PING, READ, WRITE, REG_WRITE, ACTION, RECOVERY = 1, 2, 3, 4, 5, 6
REBOOT, BACKUP, RESET_TURNS, CALIBRATE = 0x08, 0x09, 0x0A, 0x0B
SYNC_READ, SYNC_WRITE, BULK_READ = 0x82, 0x83, 0x92
MAX_DATA_BYTES = 253  # most data that the length byte of a status allows

_ERRORS = {
    InstructionError.LIMIT: 0x02,
    InstructionError.RANGE: 0x08,
    InstructionError.INSTRUCTION: 0x40,
}
_Outcome = bytes | InstructionError | None


def respond(frame: Frame, servos: Sequence[Servo]) -> list[ReplySlot]:
    """Execute a frame on the servos; return the reply slots in order."""
    for servo in servos:
        servo.received_s = servo.time_s
    if frame.instruction in _TO_MANY:
        return _TO_MANY[frame.instruction](frame.params, servos)
    if frame.id == BROADCAST:
        return _respond_to_all(frame, servos)
    addressed = [servo for servo in servos if servo.id == frame.id]
    return single_slot([reply for servo in addressed for reply in _respond_to_one(frame, servo)])


def _respond_to_one(frame: Frame, servo: Servo) -> Iterator[Reply]:
    known = frame.instruction in _TO_ONE and frame.instruction in servo.instructions
    if not known and servo.protocol is BusProtocol.FEETECH:
        return  # assumed: Feetech servos do not reply to unknown instructions
    perform = _TO_ONE[frame.instruction] if known else _reject_unknown
    outcome = perform(servo, frame.params)
    if frame.instruction == REBOOT and servo.protocol is BusProtocol.FEETECH:
        return  # the firmware restarts at once and sends no status packet
    if servo.status_level >= _LEVELS.get(frame.instruction, 2):
        yield Reply(servo, _status_packet(frame.id, servo, outcome))


def _respond_to_all(frame: Frame, servos: Sequence[Servo]) -> list[ReplySlot]:
    if frame.instruction == PING:
        answering = [servo for servo in servos if servo.answers_broadcast_ping]
        answering.sort(key=lambda servo: servo.id)
        return [
            ReplySlot((Reply(servo, _status_packet(servo.id, servo, None)),), slot=servo.id)
            for servo in answering
        ]
    if frame.instruction != READ and frame.instruction in _TO_ONE:
        for servo in servos:
            if frame.instruction in servo.instructions:
                _TO_ONE[frame.instruction](servo, frame.params)
    return []


def _status_packet(id_: int, servo: Servo, outcome: _Outcome) -> bytes:
    error = servo.alarm
    if isinstance(outcome, InstructionError) and servo.protocol is BusProtocol.DYNAMIXEL_1:
        error |= _ERRORS.get(outcome, 0x08)
    return encode1(id_, error, outcome if isinstance(outcome, bytes) else b"")


# One servo.


def _execute_ping(_: Servo, __: bytes) -> _Outcome:
    return None


def _execute_read(servo: Servo, params: bytes) -> _Outcome:
    if len(params) != 2 or not 0 < params[1] <= MAX_DATA_BYTES:
        return InstructionError.RANGE
    beyond = params[0] + params[1] > servo.table.size
    if beyond and servo.protocol is BusProtocol.DYNAMIXEL_1:
        return InstructionError.RANGE
    return servo.read_bytes(params[0], params[1])


def _execute_write(servo: Servo, params: bytes) -> _Outcome:
    return servo.write_bytes(params[0], params[1:]) if len(params) >= 2 else InstructionError.RANGE


def _execute_reg_write(servo: Servo, params: bytes) -> _Outcome:
    return (
        servo.register_write(params[0], params[1:]) if len(params) >= 2 else InstructionError.RANGE
    )


def _execute_action(servo: Servo, _: bytes) -> _Outcome:
    return servo.execute_registered()


def _execute_recovery(servo: Servo, _: bytes) -> _Outcome:
    servo.factory_reset(servo.kept_by_recovery)
    return None


def _execute_reboot(servo: Servo, _: bytes) -> _Outcome:
    servo.reboot()
    return None


def _execute_reset_turns(servo: Servo, _: bytes) -> _Outcome:
    servo.reset_turns()
    return None


def _execute_calibrate(servo: Servo, params: bytes) -> _Outcome:
    """Make the present position 2048, or the number in two further bytes."""
    if len(params) == 2:
        servo.calibrate(int.from_bytes(params, "little"))
    elif params:
        return InstructionError.RANGE
    else:
        servo.calibrate()
    return None


def _execute_backup(servo: Servo, _: bytes) -> _Outcome:
    servo.memory.store_backup()
    return None


def _reject_unknown(_: Servo, __: bytes) -> _Outcome:
    return InstructionError.INSTRUCTION


_TO_ONE: dict[int, Callable[[Servo, bytes], _Outcome]] = {
    PING: _execute_ping,
    READ: _execute_read,
    WRITE: _execute_write,
    REG_WRITE: _execute_reg_write,
    ACTION: _execute_action,
    RECOVERY: _execute_recovery,
    REBOOT: _execute_reboot,
    BACKUP: _execute_backup,
    RESET_TURNS: _execute_reset_turns,
    CALIBRATE: _execute_calibrate,
}
_LEVELS = {PING: 0, READ: 1}


# Many servos.


def _execute_sync_read(params: bytes, servos: Sequence[Servo]) -> list[ReplySlot]:
    if len(params) < 3:
        return []
    requested, present = params[:2], servos_by_id(servos)
    return [_read_reply_slot(SYNC_READ, id_, requested, present.get(id_, ())) for id_ in params[2:]]


def _execute_bulk_read(params: bytes, servos: Sequence[Servo]) -> list[ReplySlot]:
    """Parse and execute the length, id and address of each servo, after one zero."""
    groups = [params[at : at + 3] for at in range(1, len(params) - 2, 3)]
    present = servos_by_id(servos)
    return [
        _read_reply_slot(BULK_READ, id_, bytes((address, length)), present.get(id_, ()))
        for length, id_, address in groups
    ]


def _read_reply_slot(
    instruction: int, id_: int, requested: bytes, servos: Sequence[Servo]
) -> ReplySlot:
    replies = tuple(
        Reply(servo, _status_packet(id_, servo, _execute_read(servo, requested)))
        for servo in servos
        if instruction in servo.instructions and servo.status_level >= 1
    )
    return ReplySlot(replies, size=6 + requested[1])


def _execute_sync_write(params: bytes, servos: Sequence[Servo]) -> list[ReplySlot]:
    if len(params) < 2 or params[1] == 0:
        return []
    address, length, present = params[0], params[1], servos_by_id(servos)
    for at in range(2, len(params) - length, length + 1):
        for servo in present.get(params[at], ()):
            servo.write_bytes(address, params[at + 1 : at + 1 + length])
    return []


_TO_MANY: dict[int, Callable[[bytes, Sequence[Servo]], list[ReplySlot]]] = {
    SYNC_READ: _execute_sync_read,
    SYNC_WRITE: _execute_sync_write,
    BULK_READ: _execute_bulk_read,
}
