"""How joints get from here to there in time: pure functions, and the beat of the stream."""

from ikservo.motion.course import Course
from ikservo.motion.embedded import Embedded
from ikservo.motion.joint_move import JointMove, RuckigMotion, brake
from ikservo.motion.joint_route import JointRoute
from ikservo.motion.metronome import Metronome
from ikservo.motion.pace import Pace
from ikservo.motion.pursuit import Pursuit
from ikservo.motion.sequel import Sequel
from ikservo.motion.state import State
from ikservo.motion.tool_line import ToolLine, ToolRoute

__all__ = [
    "Course",
    "Embedded",
    "JointMove",
    "JointRoute",
    "Metronome",
    "Pace",
    "Pursuit",
    "RuckigMotion",
    "Sequel",
    "State",
    "ToolLine",
    "ToolRoute",
    "brake",
]
