"""Reply to a frame: the instruction handler of each protocol."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from servosim import instructions_1 as dynamixel1
from servosim import instructions_2 as dynamixel2
from servosim.frames import Frame
from servosim.instructions_1 import Reply, ReplySlot
from servosim.servo import BusProtocol, Servo

__all__ = ["ANSWERS", "Reply", "ReplySlot"]

ANSWERS: dict[BusProtocol, Callable[[Frame, Sequence[Servo]], list[ReplySlot]]] = {
    BusProtocol.DYNAMIXEL_2: dynamixel2.answer,
    BusProtocol.DYNAMIXEL_1: dynamixel1.respond,
    BusProtocol.FEETECH: dynamixel1.respond,
}
