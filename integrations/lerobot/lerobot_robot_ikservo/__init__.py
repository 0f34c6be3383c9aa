"""Use ikservo's arms in LeRobot, which finds this package by its distribution name."""

from lerobot_robot_ikservo.config import (
    IkservoLeaderConfig,
    IkservoPageConfig,
    IkservoRobotConfig,
)
from lerobot_robot_ikservo.kinematics import IkservoKinematics
from lerobot_robot_ikservo.leader import IkservoLeader
from lerobot_robot_ikservo.page import IkservoPage
from lerobot_robot_ikservo.robot import IkservoRobot

__all__ = [
    "IkservoKinematics",
    "IkservoLeader",
    "IkservoLeaderConfig",
    "IkservoPage",
    "IkservoPageConfig",
    "IkservoRobot",
    "IkservoRobotConfig",
]
