"""How joints get from here to there in time: pure functions, and the beat of the stream."""

from ikservo.motion.joint_move import JointMove, Pace
from ikservo.motion.metronome import Metronome

__all__ = ["JointMove", "Metronome", "Pace"]
