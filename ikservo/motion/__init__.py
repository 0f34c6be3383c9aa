"""Trajectories in time as pure functions, and the timer of the control loop."""

from ikservo.clock import Rate
from ikservo.motion.cartesian import CartesianTrajectory, straight_lines
from ikservo.motion.online import OnlineTrajectory
from ikservo.motion.path import BlendedPath, ToolPath
from ikservo.motion.point_to_point import JointMove, RuckigMotion, stop_trajectory
from ikservo.motion.time_scaling import JointWaypointTrajectory
from ikservo.motion.trajectory import (
    ConcatenatedTrajectory,
    KinematicLimits,
    SubsetTrajectory,
    Trajectory,
    TrajectoryPoint,
)

__all__ = [
    "BlendedPath",
    "CartesianTrajectory",
    "ConcatenatedTrajectory",
    "JointMove",
    "JointWaypointTrajectory",
    "KinematicLimits",
    "OnlineTrajectory",
    "Rate",
    "RuckigMotion",
    "SubsetTrajectory",
    "ToolPath",
    "Trajectory",
    "TrajectoryPoint",
    "stop_trajectory",
    "straight_lines",
]
