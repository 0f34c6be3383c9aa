"""What servos speak, and why they refuse."""

from __future__ import annotations

from enum import Enum

from servosim.frames import Dynamixel1Reader, Dynamixel2Reader, FrameReader

__all__ = ["Protocol", "Refusal"]


class Protocol(Enum):
    """What a servo speaks; two of them share a framing."""

    DYNAMIXEL_1 = "dynamixel 1.0"
    DYNAMIXEL_2 = "dynamixel 2.0"
    FEETECH = "feetech"

    __hash__ = object.__hash__  # every frame asks for it, and an Enum's own is slow

    @property
    def framing(self) -> type[FrameReader]:
        """The reader of its frames."""
        return Dynamixel2Reader if self is Protocol.DYNAMIXEL_2 else Dynamixel1Reader


class Refusal(Enum):
    """Why a servo will not do what an instruction asks."""

    RESULT_FAIL = "result fail"
    INSTRUCTION = "instruction"
    RANGE = "range"
    LENGTH = "length"
    LIMIT = "limit"
    ACCESS = "access"
