"""An arm on its servos: open it, move it, read its state, switch its torque off."""

from ikservo.arm.arm import Arm, OnExit
from ikservo.arm.background_motion import Motion
from ikservo.arm.calibrated_arm import ZeroSource
from ikservo.arm.following import check_followed_goal
from ikservo.arm.opening import open_arm
from ikservo.arm.plan import MotionPlan
from ikservo.arm.recorder import read_recording
from ikservo.arm.recording import Recording
from ikservo.arm.reports import (
    ArmState,
    JointMoveResult,
    MotionProgress,
    MoveResult,
    SampledTrajectory,
)
from ikservo.arm.setpoint_stream import SetpointStream
from ikservo.arm.tool_orientation import ToolOrientation
from ikservo.control.feedback import JointState
from ikservo.deprecation import current_name
from ikservo.guard import DEAD_MAN_TIMEOUT_S, StopKind, StopReason

__all__ = [
    "DEAD_MAN_TIMEOUT_S",
    "Arm",
    "ArmState",
    "JointMoveResult",
    "JointState",
    "Motion",
    "MotionPlan",
    "MotionProgress",
    "MoveResult",
    "OnExit",
    "Recording",
    "SampledTrajectory",
    "SetpointStream",
    "StopKind",
    "StopReason",
    "ToolOrientation",
    "ZeroSource",
    "check_followed_goal",
    "open_arm",
    "read_recording",
]

# Names of version 0.1, kept for one version more.
_RENAMED = {
    "JointReport": "JointMoveResult",
    "MoveReport": "MoveResult",
    "Plan": "MotionPlan",
    "Progress": "MotionProgress",
    "Stance": "ToolOrientation",
    "Whereabouts": "ArmState",
    "Zeros": "ZeroSource",
}


def __getattr__(name: str) -> object:
    return globals()[current_name("ikservo.arm", _RENAMED, name)]
