"""The gate before the bytes: what it lets pass is inside the limits, free of contact, no jump."""

from ikservo.guard.dead_man import DEAD_MAN_TIMEOUT_S, DeadMan
from ikservo.guard.fence import Fence
from ikservo.guard.following import Following
from ikservo.guard.gate import Gate
from ikservo.guard.health import Health, HealthLimits, Vitals
from ikservo.guard.latch import Latch, StopKind, StopReason
from ikservo.guard.look_ahead import LookAhead
from ikservo.guard.lost import Losses
from ikservo.guard.sagging import Weight, sag_of
from ikservo.guard.space import (
    MAX_SAMPLE_STEP_RAD,
    Box,
    Space,
    sample_line,
    sample_path,
    thin_path,
)

__all__ = [
    "DEAD_MAN_TIMEOUT_S",
    "MAX_SAMPLE_STEP_RAD",
    "Box",
    "DeadMan",
    "Fence",
    "Following",
    "Gate",
    "Health",
    "HealthLimits",
    "Latch",
    "LookAhead",
    "Losses",
    "Space",
    "StopKind",
    "StopReason",
    "Vitals",
    "Weight",
    "sag_of",
    "sample_line",
    "sample_path",
    "thin_path",
]
