"""The machine a person owns: open it, move it, ask where it is, let it go."""

from ikservo.arm.arm import Arm, OnExit
from ikservo.arm.background import Motion, SetpointStream
from ikservo.arm.opening import open_arm
from ikservo.arm.planning import Plan, Stance
from ikservo.arm.reports import JointReport, MoveReport, Progress, Whereabouts
from ikservo.arm.streaming.halt import StopKind, StopReason
from ikservo.arm.streaming.states import JointState
from ikservo.arm.tapes.tape import Recording
from ikservo.arm.tapes.tape_reading import read_recording
from ikservo.arm.trajectory import Trajectory
from ikservo.arm.trust import Zeros
from ikservo.guard import DEAD_MAN_TIMEOUT_S

__all__ = [
    "DEAD_MAN_TIMEOUT_S",
    "Arm",
    "JointReport",
    "JointState",
    "Motion",
    "MoveReport",
    "OnExit",
    "Plan",
    "Progress",
    "Recording",
    "SetpointStream",
    "Stance",
    "StopKind",
    "StopReason",
    "Trajectory",
    "Whereabouts",
    "Zeros",
    "open_arm",
    "read_recording",
]
