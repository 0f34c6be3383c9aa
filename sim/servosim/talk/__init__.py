"""What servos answer: from a frame on the line to the turns in which they speak."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from servosim.frames import Frame
from servosim.protocol import Protocol
from servosim.servo import Servo
from servosim.talk import dynamixel1, dynamixel2
from servosim.talk.turn import Reply, Turn

__all__ = ["ANSWERS", "Reply", "Turn"]

ANSWERS: dict[Protocol, Callable[[Frame, Sequence[Servo]], list[Turn]]] = {
    Protocol.DYNAMIXEL_2: dynamixel2.answer,
    Protocol.DYNAMIXEL_1: dynamixel1.answer,
    Protocol.FEETECH: dynamixel1.answer,
}
