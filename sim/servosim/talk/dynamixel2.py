"""Who answers an instruction of Dynamixel protocol 2.0 (e-manual, "instruction details")."""

from __future__ import annotations

from collections.abc import Sequence

from servosim.frames import Frame
from servosim.servo import Servo
from servosim.talk import dynamixel2_one as one
from servosim.talk.dynamixel2_many import TO_MANY
from servosim.talk.dynamixel2_one import LEVELS, perform, ping, status, touches_eeprom
from servosim.talk.turn import BROADCAST, Reply, Turn, one_turn

__all__ = ["answer"]


def answer(frame: Frame, servos: Sequence[Servo]) -> list[Turn]:
    """Let the servos do what a frame asks; return who answers in which order."""
    for servo in servos:
        servo.heard_s = servo.time_s
    if frame.instruction == one.STATUS:
        return []
    if frame.instruction in TO_MANY:
        return TO_MANY[frame.instruction](frame.params, servos)
    if frame.id == BROADCAST:
        return _to_all(frame, servos)
    return _to_one(frame, servos)


def _to_one(frame: Frame, servos: Sequence[Servo]) -> list[Turn]:
    replies: list[Reply] = []
    for servo in servos:
        if servo.id == frame.id:
            level = LEVELS.get(frame.instruction, 2)
            outcome = perform(frame.instruction, frame.params, servo)
            if servo.status_level >= level:
                replies.append(Reply(servo, status(frame.id, servo, outcome)))
        elif servo.secondary_id == frame.id:
            _obey_as_shadow(frame, servo)
    return one_turn(replies)


def _to_all(frame: Frame, servos: Sequence[Servo]) -> list[Turn]:
    if frame.instruction == one.PING:
        return [_ping_turn(servo) for servo in sorted(servos, key=lambda servo: servo.id)]
    if frame.instruction != one.READ and (frame.instruction, frame.params) != (
        one.FACTORY_RESET,
        b"\xff",
    ):
        for servo in servos:
            perform(frame.instruction, frame.params, servo)
    return []


def _ping_turn(servo: Servo) -> Turn:
    return Turn((Reply(servo, status(servo.id, servo, ping(servo))),), slot=servo.id)


def _obey_as_shadow(frame: Frame, servo: Servo) -> None:
    """A secondary id takes instructions, but neither reads nor writes to EEPROM."""
    writes = frame.instruction in (one.WRITE, one.REG_WRITE)
    allowed = writes and not touches_eeprom(servo, frame.params)
    if allowed or frame.instruction in (one.ACTION, one.REBOOT, one.CLEAR):
        perform(frame.instruction, frame.params, servo)
