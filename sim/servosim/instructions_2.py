"""Instructions of protocol 2.0 (e-manual, "instruction details")."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from servosim.dynamixel_x import SimulatedDynamixelX
from servosim.frames import HEADER, MAX_FRAME_BYTES, Frame, crc16, encode2
from servosim.instructions_1 import BROADCAST, Reply, ReplySlot, servos_by_id, single_slot
from servosim.servo import InstructionError, Servo

PING, READ, WRITE, REG_WRITE, ACTION, FACTORY_RESET, REBOOT = 1, 2, 3, 4, 5, 6, 8
CLEAR, BACKUP, STATUS = 0x10, 0x20, 0x55

LEVELS = {PING: 0, READ: 1}  # status return level needed for a reply; otherwise 2

_ERRORS = {
    InstructionError.RESULT_FAIL: 1,
    InstructionError.INSTRUCTION: 2,
    InstructionError.RANGE: 4,
    InstructionError.LENGTH: 5,
    InstructionError.LIMIT: 6,
    InstructionError.ACCESS: 7,
}
Outcome = bytes | InstructionError | None


def execute_instruction(instruction: int, params: bytes, servo: Servo) -> Outcome:
    """Execute an instruction on a servo; return its data, or why it refuses."""
    do = _TO_ONE.get(instruction)
    return do(servo, params) if do else InstructionError.INSTRUCTION


def status_packet(id_: int, servo: Servo, outcome: Outcome) -> bytes:
    """Return the status packet of an outcome."""
    if isinstance(outcome, bytes):
        return encode2(id_, STATUS, bytes((servo.alarm,)) + outcome)
    error = 0 if outcome is None else _ERRORS[outcome]
    return encode2(id_, STATUS, bytes((error | servo.alarm,)))


def touches_eeprom(servo: Servo, address: int, length: int) -> bool:
    """Check whether a write includes EEPROM registers."""
    rows = servo.table.registers_in(address, length)
    return any(row.persists for row in rows)


def read_uint16(params: bytes, at: int) -> int:
    """Read the 16-bit number at an index."""
    return int.from_bytes(params[at : at + 2], "little")


def execute_ping(servo: Servo, _: bytes = b"") -> Outcome:
    """Return model number and firmware version."""
    return servo.table.number.to_bytes(2, "little") + bytes((servo.memory.get("firmware_version"),))


def execute_read(servo: Servo, params: bytes) -> Outcome:
    """Parse address and length; return the bytes there."""
    if len(params) != 4:
        return InstructionError.LENGTH
    return read_at(servo, read_uint16(params, 0), read_uint16(params, 2))


def read_at(servo: Servo, address: int, length: int) -> Outcome:
    """Return the bytes at an address, if all of them are inside the memory."""
    if length == 0 or address + length > servo.table.size:
        return InstructionError.ACCESS
    return servo.read_bytes(address, length)


def execute_write(servo: Servo, params: bytes) -> Outcome:
    """Parse address and bytes, and store them there."""
    if len(params) < 3:
        return InstructionError.LENGTH
    return servo.write_bytes(read_uint16(params, 0), params[2:])


def _execute_reg_write(servo: Servo, params: bytes) -> Outcome:
    if len(params) < 3:
        return InstructionError.LENGTH
    return servo.register_write(read_uint16(params, 0), params[2:])


def _execute_action(servo: Servo, _: bytes) -> Outcome:
    return servo.execute_registered()


def _execute_factory_reset(servo: Servo, params: bytes) -> Outcome:
    keep = {b"\xff": (), b"\x01": ("id",), b"\x02": ("id", "baud_rate")}.get(params)
    if keep is None:
        return InstructionError.RANGE
    servo.factory_reset(keep)
    return None


def _execute_reboot(servo: Servo, _: bytes) -> Outcome:
    servo.reboot()
    return None


def _execute_clear(servo: Servo, params: bytes) -> Outcome:
    if params != b"\x01DXL\x22" or not isinstance(servo, SimulatedDynamixelX):
        return InstructionError.RANGE
    if servo.motor.moving:
        return InstructionError.RESULT_FAIL
    servo.reset_turns()
    servo.reset_goals_to_present()
    return None


def _execute_backup(servo: Servo, params: bytes) -> Outcome:
    if (
        params[1:] != b"CTRL"
        or params[0] not in (1, 2)
        or not isinstance(servo, SimulatedDynamixelX)
    ):
        return InstructionError.RANGE
    return servo.backup.store() if params[0] == 1 else servo.backup.restore()


_TO_ONE: dict[int, Callable[[Servo, bytes], Outcome]] = {
    PING: execute_ping,
    READ: execute_read,
    WRITE: execute_write,
    REG_WRITE: _execute_reg_write,
    ACTION: _execute_action,
    FACTORY_RESET: _execute_factory_reset,
    REBOOT: _execute_reboot,
    CLEAR: _execute_clear,
    BACKUP: _execute_backup,
}


SYNC_READ, SYNC_WRITE, FAST_SYNC_READ = 0x82, 0x83, 0x8A
BULK_READ, BULK_WRITE, FAST_BULK_READ = 0x92, 0x93, 0x9A
_ReadRequest = tuple[int, int, int]  # id, address, length


def _execute_sync_read(params: bytes, servos: Sequence[Servo]) -> list[ReplySlot]:
    there = servos_by_id(servos)
    return [
        _read_reply_slot(request, there.get(request[0], ())) for request in _sync_requests(params)
    ]


def _execute_bulk_read(params: bytes, servos: Sequence[Servo]) -> list[ReplySlot]:
    there = servos_by_id(servos)
    return [
        _read_reply_slot(request, there.get(request[0], ())) for request in _bulk_requests(params)
    ]


def _execute_fast_sync_read(params: bytes, servos: Sequence[Servo]) -> list[ReplySlot]:
    return _fast_reply_slots(list(_sync_requests(params)), servos)


def _execute_fast_bulk_read(params: bytes, servos: Sequence[Servo]) -> list[ReplySlot]:
    return _fast_reply_slots(list(_bulk_requests(params)), servos)


def _execute_sync_write(params: bytes, servos: Sequence[Servo]) -> list[ReplySlot]:
    if len(params) < 4:
        return []
    address, length = read_uint16(params, 0), read_uint16(params, 2)
    there = _write_targets(servos)
    for at in range(4, len(params) - length, length + 1):
        data = params[at + 1 : at + 1 + length]
        _write_to_servos(there.get(params[at], ()), params[at], address, data)
    return []


def _execute_bulk_write(params: bytes, servos: Sequence[Servo]) -> list[ReplySlot]:
    at, there = 0, _write_targets(servos)
    while at + 5 <= len(params):
        length = read_uint16(params, at + 3)
        data = params[at + 5 : at + 5 + length]
        if len(data) == length:
            address = read_uint16(params, at + 1)
            _write_to_servos(there.get(params[at], ()), params[at], address, data)
        at += 5 + length
    return []


def _write_targets(servos: Sequence[Servo]) -> dict[int, list[Servo]]:
    """Return the servos that accept writes to each id, secondary ids included."""
    found = servos_by_id(servos)
    for servo in servos:
        if servo.secondary_id is not None:
            found.setdefault(servo.secondary_id, []).append(servo)
    return found


def _write_to_servos(servos: Sequence[Servo], id_: int, address: int, data: bytes) -> None:
    for servo in servos:
        if data and (servo.id == id_ or not touches_eeprom(servo, address, len(data))):
            servo.write_bytes(address, data)


def _sync_requests(params: bytes) -> Iterator[_ReadRequest]:
    if len(params) >= 4:
        address, length = read_uint16(params, 0), read_uint16(params, 2)
        for id_ in params[4:]:
            yield id_, address, length


def _bulk_requests(params: bytes) -> Iterator[_ReadRequest]:
    for at in range(0, len(params) - 4, 5):
        yield params[at], read_uint16(params, at + 1), read_uint16(params, at + 3)


def _read_reply_slot(request: _ReadRequest, servos: Sequence[Servo]) -> ReplySlot:
    id_, address, length = request
    replies = [
        Reply(servo, status_packet(id_, servo, read_at(servo, address, length)))
        for servo in servos
        if servo.status_level >= 1
    ]
    return ReplySlot(tuple(replies), 11 + length)


def _fast_reply_slots(requests: list[_ReadRequest], servos: Sequence[Servo]) -> list[ReplySlot]:
    """Return one status packet in parts; the chain breaks at the first missing servo."""
    present = servos_by_id(servos)
    length = 1 + sum(4 + request[2] for request in requests)
    if length > MAX_FRAME_BYTES:
        return []  # assumed: no reply if it does not fit into a packet
    so_far = HEADER + bytes((BROADCAST, length & 0xFF, length >> 8, STATUS))
    slots: list[ReplySlot] = []
    for id_, address, size in requests:
        there = [s for s in present.get(id_, ()) if s.status_level >= 1 and s.knows_fast_reads]
        if not there or address + size > there[0].table.size:
            break
        part = bytes((there[0].alarm, id_)) + there[0].read_bytes(address, size)
        crc = crc16(so_far + part).to_bytes(2, "little")
        data = (b"" if slots else so_far) + part + crc
        slots.append(ReplySlot(tuple(Reply(servo, data) for servo in there), prompt=bool(slots)))
        so_far += part + crc
    return slots


TO_MANY: dict[int, Callable[[bytes, Sequence[Servo]], list[ReplySlot]]] = {
    SYNC_READ: _execute_sync_read,
    SYNC_WRITE: _execute_sync_write,
    FAST_SYNC_READ: _execute_fast_sync_read,
    BULK_READ: _execute_bulk_read,
    BULK_WRITE: _execute_bulk_write,
    FAST_BULK_READ: _execute_fast_bulk_read,
}


def answer(frame: Frame, servos: Sequence[Servo]) -> list[ReplySlot]:
    """Execute a frame on the servos; return the reply slots in order."""
    for servo in servos:
        servo.received_s = servo.time_s
    if frame.instruction == STATUS:
        return []
    if frame.instruction in TO_MANY:
        return TO_MANY[frame.instruction](frame.params, servos)
    if frame.id == BROADCAST:
        return _respond_to_all(frame, servos)
    return _respond_to_one(frame, servos)


def _respond_to_one(frame: Frame, servos: Sequence[Servo]) -> list[ReplySlot]:
    replies: list[Reply] = []
    for servo in servos:
        if servo.id == frame.id:
            level = LEVELS.get(frame.instruction, 2)
            outcome = execute_instruction(frame.instruction, frame.params, servo)
            if servo.status_level >= level:
                replies.append(Reply(servo, status_packet(frame.id, servo, outcome)))
        elif servo.secondary_id == frame.id:
            _execute_for_secondary_id(frame, servo)
    return single_slot(replies)


def _respond_to_all(frame: Frame, servos: Sequence[Servo]) -> list[ReplySlot]:
    if frame.instruction == PING:
        return [_ping_reply_slot(servo) for servo in sorted(servos, key=lambda servo: servo.id)]
    if frame.instruction != READ and (frame.instruction, frame.params) != (
        FACTORY_RESET,
        b"\xff",
    ):
        for servo in servos:
            execute_instruction(frame.instruction, frame.params, servo)
    return []


def _ping_reply_slot(servo: Servo) -> ReplySlot:
    return ReplySlot(
        (Reply(servo, status_packet(servo.id, servo, execute_ping(servo))),), slot=servo.id
    )


def _execute_for_secondary_id(frame: Frame, servo: Servo) -> None:
    """Execute for a secondary id, which accepts no reads and no writes to EEPROM."""
    writes = frame.instruction in (WRITE, REG_WRITE)
    params = frame.params
    allowed = writes and not touches_eeprom(servo, read_uint16(params, 0), len(params) - 2)
    if allowed or frame.instruction in (ACTION, REBOOT, CLEAR):
        execute_instruction(frame.instruction, frame.params, servo)
