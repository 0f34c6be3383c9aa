"""``--teleop.type=ikservo_leader``: an ikservo arm, guided by hand, leads a robot."""

from __future__ import annotations

import logging
from typing import Any

from lerobot.teleoperators import Teleoperator

import ikservo
from lerobot_robot_ikservo.arm_connection import ArmConnection
from lerobot_robot_ikservo.config import IkservoLeaderConfig

__all__ = ["IkservoLeader"]

_LOG = logging.getLogger(__name__)


class IkservoLeader(Teleoperator):
    """A leader arm; its torque stays unchanged.

    Args:
        config: See ``IkservoLeaderConfig``.
    """

    config_class = IkservoLeaderConfig
    name = "ikservo_leader"

    def __init__(self, config: IkservoLeaderConfig) -> None:
        super().__init__(config)
        self.config = config
        self._connection = ArmConnection(config, str(self))

    @property
    def action_features(self) -> dict[str, type]:
        """Return one value per joint."""
        return self._connection.values.features

    @property
    def feedback_features(self) -> dict[str, type]:
        """Return an empty mapping, because there is no feedback."""
        return {}

    @property
    def is_connected(self) -> bool:
        """Return whether the arm is open."""
        return self._connection.is_open

    @property
    def is_calibrated(self) -> bool:
        """Return whether the zeros of the arm's joints are known."""
        return self._connection.arm.zeros.are_known

    def connect(self, calibrate: bool = True) -> None:
        """Open the arm; nothing moves and no torque changes.

        Raises:
            DeviceAlreadyConnectedError: The arm is already open.
        """
        self._connection.open()
        if calibrate and not self.is_calibrated:
            self.calibrate()
        if self._connection.arm.where().torque.any():
            _LOG.warning("The leader's torque is on; to guide it by hand, run: ikservo relax")

    def calibrate(self) -> None:
        """Calibrate the leader in the same way as the robot."""
        if self._connection.calibrate(self.calibration_fpath):
            self._load_calibration()

    def configure(self) -> None:
        """Do nothing."""

    def get_action(self) -> dict[str, float]:
        """Return the measured joints."""
        arm = self._connection.arm
        measured = (
            arm.context.servos.measure_positions()  # only positions, to keep LeRobot's rate
            if isinstance(arm, ikservo.Arm)
            else arm.where().positions_rad
        )
        return self._connection.values.from_positions(measured)

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Do nothing."""

    def disconnect(self) -> None:
        """Close the arm; its torque stays unchanged."""
        self._connection.close()
