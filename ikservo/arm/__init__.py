"""The machine a person owns: open it, move it, ask where it is, let it go."""

from ikservo.arm.arm import Arm, OnExit
from ikservo.arm.opening import open_arm
from ikservo.arm.planning import Plan, Stance
from ikservo.arm.reports import JointReport, JointState, MoveReport, Progress, Whereabouts
from ikservo.arm.trust import Zeros

__all__ = [
    "Arm",
    "JointReport",
    "JointState",
    "MoveReport",
    "OnExit",
    "Plan",
    "Progress",
    "Stance",
    "Whereabouts",
    "Zeros",
    "open_arm",
]
