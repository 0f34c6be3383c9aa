"""What a motion would be before it starts: where it goes, how, how long, and what comes close."""

from ikservo.arm.planning.beginning import begun, has_moved
from ikservo.arm.planning.inside import Inside, brought_inside, posed_inside
from ikservo.arm.planning.plan import NearLimit, Plan
from ikservo.arm.planning.planner import Planner
from ikservo.arm.planning.rising import RISEN, risen
from ikservo.arm.planning.stance import AS_IT_CAN, Stance, stance_of

__all__ = [
    "AS_IT_CAN",
    "RISEN",
    "Inside",
    "NearLimit",
    "Plan",
    "Planner",
    "Stance",
    "begun",
    "brought_inside",
    "has_moved",
    "posed_inside",
    "risen",
    "stance_of",
]
