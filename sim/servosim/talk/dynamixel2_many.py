"""Instructions of Dynamixel protocol 2.0 to many servos: sync, bulk and fast reads and writes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from servosim.frames import crc16
from servosim.frames.dynamixel2 import HEADER, LONGEST
from servosim.servo import Servo
from servosim.talk.dynamixel2_one import STATUS, read_at, status, touches_eeprom, word, write
from servosim.talk.turn import BROADCAST, Reply, Turn, by_id

__all__ = ["TO_MANY"]

SYNC_READ, SYNC_WRITE, FAST_SYNC_READ = 0x82, 0x83, 0x8A
BULK_READ, BULK_WRITE, FAST_BULK_READ = 0x92, 0x93, 0x9A
_Request = tuple[int, int, int]  # id, address, length


def _sync_read(params: bytes, servos: Sequence[Servo]) -> list[Turn]:
    there = by_id(servos)
    return [_read_turn(request, there.get(request[0], ())) for request in _sync_requests(params)]


def _bulk_read(params: bytes, servos: Sequence[Servo]) -> list[Turn]:
    there = by_id(servos)
    return [_read_turn(request, there.get(request[0], ())) for request in _bulk_requests(params)]


def _fast_sync_read(params: bytes, servos: Sequence[Servo]) -> list[Turn]:
    return _fast_turns(list(_sync_requests(params)), servos)


def _fast_bulk_read(params: bytes, servos: Sequence[Servo]) -> list[Turn]:
    return _fast_turns(list(_bulk_requests(params)), servos)


def _sync_write(params: bytes, servos: Sequence[Servo]) -> list[Turn]:
    if len(params) < 4:
        return []
    head, length, there = params[:2], word(params, 2), _obeying(servos)
    for at in range(4, len(params) - length, length + 1):
        _write_to(there.get(params[at], ()), params[at], head + params[at + 1 : at + 1 + length])
    return []


def _bulk_write(params: bytes, servos: Sequence[Servo]) -> list[Turn]:
    at, there = 0, _obeying(servos)
    while at + 5 <= len(params):
        length = word(params, at + 3)
        data = params[at + 5 : at + 5 + length]
        if len(data) == length:
            _write_to(there.get(params[at], ()), params[at], params[at + 1 : at + 3] + data)
        at += 5 + length
    return []


def _obeying(servos: Sequence[Servo]) -> dict[int, list[Servo]]:
    """Return who obeys writes to which id, secondary ids included."""
    found = by_id(servos)
    for servo in servos:
        if servo.secondary_id is not None:
            found.setdefault(servo.secondary_id, []).append(servo)
    return found


def _write_to(servos: Sequence[Servo], id_: int, params: bytes) -> None:
    for servo in servos:
        if servo.id == id_ or not touches_eeprom(servo, params):
            write(servo, params)


def _sync_requests(params: bytes) -> Iterator[_Request]:
    if len(params) >= 4:
        address, length = word(params, 0), word(params, 2)
        for id_ in params[4:]:
            yield id_, address, length


def _bulk_requests(params: bytes) -> Iterator[_Request]:
    for at in range(0, len(params) - 4, 5):
        yield params[at], word(params, at + 1), word(params, at + 3)


def _read_turn(request: _Request, servos: Sequence[Servo]) -> Turn:
    id_, address, length = request
    replies = [
        Reply(servo, status(id_, servo, read_at(servo, address, length)))
        for servo in servos
        if servo.status_level >= 1
    ]
    return Turn(tuple(replies), 11 + length)


def _fast_turns(requests: list[_Request], servos: Sequence[Servo]) -> list[Turn]:
    """One status packet in shares; the chain breaks at the first servo that is missing."""
    everybody = by_id(servos)
    length = 1 + sum(4 + request[2] for request in requests)
    if length > LONGEST:
        return []  # assumed: nobody answers what fits into no packet
    so_far = HEADER + bytes((BROADCAST, length & 0xFF, length >> 8, STATUS))
    turns: list[Turn] = []
    for id_, address, size in requests:
        there = [servo for servo in everybody.get(id_, ()) if servo.status_level >= 1]
        if not there or address + size > there[0].table.size:
            break
        share = bytes((there[0].alarm, id_)) + there[0].read_bytes(address, size)
        crc = crc16(so_far + share).to_bytes(2, "little")
        data = (b"" if turns else so_far) + share + crc
        turns.append(Turn(tuple(Reply(servo, data) for servo in there), prompt=bool(turns)))
        so_far += share + crc
    return turns


TO_MANY: dict[int, Callable[[bytes, Sequence[Servo]], list[Turn]]] = {
    SYNC_READ: _sync_read,
    SYNC_WRITE: _sync_write,
    FAST_SYNC_READ: _fast_sync_read,
    BULK_READ: _bulk_read,
    BULK_WRITE: _bulk_write,
    FAST_BULK_READ: _fast_bulk_read,
}
