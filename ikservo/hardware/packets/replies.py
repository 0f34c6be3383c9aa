"""What comes back from a servo: a status, or the reason why there is none."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

__all__ = ["Fault", "FaultKind", "Reply", "Status"]


@dataclass(frozen=True, slots=True)
class Status:
    """A valid status packet.

    Attributes:
        servo_id: Who answered.
        data: The parameters, exactly as many bytes as were asked for.
        alarm_bits: The servo's complaint about itself; the data are valid all the same.
        doubtful: It cannot be told from the answer to an earlier question.
    """

    servo_id: int
    data: bytes = b""
    alarm_bits: int = 0
    doubtful: bool = False


class FaultKind(Enum):
    """Why a question has no answer."""

    SILENT = "silent"
    GARBLED = "garbled"
    REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class Fault:
    """The reason why a servo's answer is missing.

    Attributes:
        servo_id: Who was asked.
        kind: Silent, garbled or refused.
        found: What happened, to stand behind the servo's name: "does not answer".
        alarm_bits: What a refusing servo complained about besides.
        sent: The question.
        received: Everything that was heard.
    """

    servo_id: int
    kind: FaultKind
    found: str
    alarm_bits: int = 0
    sent: bytes = b""
    received: bytes = b""


Reply = Status | Fault
