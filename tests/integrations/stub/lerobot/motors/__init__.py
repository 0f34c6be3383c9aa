from dataclasses import dataclass
from enum import StrEnum


class MotorNormMode(StrEnum):
    RANGE_0_100 = "range_0_100"
    DEGREES = "degrees"


@dataclass
class Motor:
    id: int
    model: str
    norm_mode: MotorNormMode
