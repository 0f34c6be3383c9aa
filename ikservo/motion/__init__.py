"""Trajectories in time: pure functions, and the loop timer of the stream."""

from ikservo.motion.cartesian import CartesianTrajectory
from ikservo.motion.online import OnlineTrajectory
from ikservo.motion.point_to_point import JointMove, RuckigMotion, stop_trajectory
from ikservo.motion.rate import Rate
from ikservo.motion.time_scaling import JointWaypointTrajectory
from ikservo.motion.trajectory import (
    ConcatenatedTrajectory,
    KinematicLimits,
    SubsetTrajectory,
    Trajectory,
    TrajectoryPoint,
)

__all__ = [
    "CartesianTrajectory",
    "ConcatenatedTrajectory",
    "JointMove",
    "JointWaypointTrajectory",
    "KinematicLimits",
    "OnlineTrajectory",
    "Rate",
    "RuckigMotion",
    "SubsetTrajectory",
    "Trajectory",
    "TrajectoryPoint",
    "stop_trajectory",
]
