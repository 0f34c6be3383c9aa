"""Arms and their servos: open an arm, move it, read its state, switch its torque off.

Names are imported when they are first used, because ``ikservo stop`` imports a module of this
package and must not wait for NumPy.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ikservo.arguments import OnExit
    from ikservo.arm.arm import Arm
    from ikservo.arm.arm_protocol import OpenArm
    from ikservo.arm.background_motion import Motion, RunningMotion
    from ikservo.arm.following import check_followed_goal
    from ikservo.arm.opening import open_arm
    from ikservo.arm.setpoint_stream import SetpointStream
    from ikservo.control.joint_reading import JointState
    from ikservo.guard import StopKind, StopReason
    from ikservo.guard.dead_man import DEAD_MAN_TIMEOUT_S
    from ikservo.planning.calibrated_arm import ZeroSource
    from ikservo.planning.motion_plan import MotionPlan
    from ikservo.planning.path_constraint import PathConstraint
    from ikservo.planning.reports import ArmState, JointMoveResult, MotionProgress, MoveResult
    from ikservo.planning.tool_orientation import ToolOrientation

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
    "OpenArm",
    "PathConstraint",
    "RunningMotion",
    "SetpointStream",
    "StopKind",
    "StopReason",
    "ToolOrientation",
    "ZeroSource",
    "check_followed_goal",
    "open_arm",
]

_HOMES = {
    "Arm": "arm.arm",
    "ArmState": "planning.reports",
    "DEAD_MAN_TIMEOUT_S": "guard.dead_man",
    "JointMoveResult": "planning.reports",
    "JointState": "control.joint_reading",
    "Motion": "arm.background_motion",
    "MotionPlan": "planning.motion_plan",
    "MotionProgress": "planning.reports",
    "MoveResult": "planning.reports",
    "OnExit": "arguments",
    "OpenArm": "arm.arm_protocol",
    "RunningMotion": "arm.background_motion",
    "SetpointStream": "arm.setpoint_stream",
    "StopKind": "guard",
    "StopReason": "guard",
    "PathConstraint": "planning.path_constraint",
    "ToolOrientation": "planning.tool_orientation",
    "ZeroSource": "planning.calibrated_arm",
    "check_followed_goal": "arm.following",
    "open_arm": "arm.opening",
}


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}", name=name)
    value = globals()[name] = getattr(import_module(f"ikservo.{_HOMES[name]}"), name)
    return value  # later look-ups do not come here


def __dir__() -> list[str]:
    return sorted(__all__)
