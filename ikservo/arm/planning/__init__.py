"""What a motion would be before it starts: where it goes, how, how long, and what comes close."""

from ikservo.arm.planning.beginning import begun
from ikservo.arm.planning.plan import NearLimit, Plan
from ikservo.arm.planning.planner import Planner
from ikservo.arm.planning.rising import RISEN, risen
from ikservo.arm.planning.stance import AS_IT_CAN, Stance, stance_of

__all__ = [
    "AS_IT_CAN",
    "RISEN",
    "NearLimit",
    "Plan",
    "Planner",
    "Stance",
    "begun",
    "risen",
    "stance_of",
]
