"""Safety checks of every goal: limits, collisions, steps, and monitors of a running motion."""

from ikservo.guard.clear_space import ClearSpace
from ikservo.guard.collision import (
    MAX_SAMPLE_STEP_RAD,
    CollisionChecker,
    refine_path,
    sample_line,
    sample_path,
    thin_path,
)
from ikservo.guard.contact_release import nearest_free_posture
from ikservo.guard.driven_joint import MAX_TRAVEL_RAD, DrivenJoint
from ikservo.guard.gate import Gate, StopKind, StopLatch, StopReason
from ikservo.guard.monitors import (
    DEAD_MAN_TIMEOUT_S,
    CommunicationMonitor,
    DeadManSwitch,
    HealthMonitor,
    ServoTelemetry,
    TrackingMonitor,
    alarm_hint,
    power_lost_error,
    torque_lost_error,
)
from ikservo.guard.overload import OverloadMonitor, OverloadRule
from ikservo.guard.sag import Weight, sag_of
from ikservo.model.model import HealthLimits, KeepOutBox

__all__ = [
    "DEAD_MAN_TIMEOUT_S",
    "MAX_SAMPLE_STEP_RAD",
    "MAX_TRAVEL_RAD",
    "ClearSpace",
    "CollisionChecker",
    "CommunicationMonitor",
    "DeadManSwitch",
    "DrivenJoint",
    "Gate",
    "HealthLimits",
    "HealthMonitor",
    "KeepOutBox",
    "OverloadMonitor",
    "OverloadRule",
    "ServoTelemetry",
    "StopKind",
    "StopLatch",
    "StopReason",
    "TrackingMonitor",
    "Weight",
    "alarm_hint",
    "nearest_free_posture",
    "power_lost_error",
    "refine_path",
    "sag_of",
    "sample_line",
    "sample_path",
    "thin_path",
    "torque_lost_error",
]
