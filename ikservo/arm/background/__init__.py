"""Motions that go on while the program does something else, and streams of setpoints."""

from ikservo.arm.background.motion import Motion
from ikservo.arm.background.runner import Background
from ikservo.arm.background.setpoint_stream import SetpointStream

__all__ = ["Background", "Motion", "SetpointStream"]
