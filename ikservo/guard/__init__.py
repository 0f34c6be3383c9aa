"""Safety checks of every goal: limits, collisions, steps, and monitors of a running motion."""

from ikservo.guard.collision import CollisionChecker
from ikservo.guard.driven_joint import DrivenJoint, TickRow
from ikservo.guard.following_error import TrackingMonitor, overweight_error
from ikservo.guard.gate import Gate, PassedGoals
from ikservo.guard.goal_lead import MAX_TRAVEL_RAD
from ikservo.guard.overload_prediction import OverloadMonitor, OverloadRule
from ikservo.guard.path_sampling import (
    MAX_SAMPLE_STEP_RAD,
    refine_path,
    sample_line,
    sample_path,
    thin_path,
)
from ikservo.guard.servo_health import (
    CommunicationMonitor,
    HealthMonitor,
    ServoTelemetry,
    alarm_hint,
    power_lost_error,
    say_what_fell,
    torque_lost_error,
)
from ikservo.guard.stop_latch import StopKind, StopLatch, StopReason
from ikservo.model.arm_model import HealthLimits, KeepOutBox

__all__ = [
    "MAX_SAMPLE_STEP_RAD",
    "MAX_TRAVEL_RAD",
    "CollisionChecker",
    "CommunicationMonitor",
    "DrivenJoint",
    "Gate",
    "HealthLimits",
    "HealthMonitor",
    "KeepOutBox",
    "OverloadMonitor",
    "OverloadRule",
    "PassedGoals",
    "ServoTelemetry",
    "StopKind",
    "StopLatch",
    "StopReason",
    "TickRow",
    "TrackingMonitor",
    "alarm_hint",
    "overweight_error",
    "power_lost_error",
    "refine_path",
    "sample_line",
    "sample_path",
    "say_what_fell",
    "thin_path",
    "torque_lost_error",
]
