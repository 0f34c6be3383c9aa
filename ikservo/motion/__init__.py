"""How joints get from here to there in time: pure functions, and the beat of the stream."""

from ikservo.motion.course import Course
from ikservo.motion.joint_move import JointMove, brake
from ikservo.motion.metronome import Metronome
from ikservo.motion.pace import Pace
from ikservo.motion.state import State
from ikservo.motion.tool_line import ToolLine

__all__ = ["Course", "JointMove", "Metronome", "Pace", "State", "ToolLine", "brake"]
