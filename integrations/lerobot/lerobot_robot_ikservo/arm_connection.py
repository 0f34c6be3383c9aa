"""The arm of a robot or teleoperator of LeRobot: opened, calibrated and closed."""

from __future__ import annotations

from pathlib import Path

from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

import ikservo
from ikservo.apps.teaching.lerobot_values import JointValues
from ikservo.arm import OnExit
from lerobot_robot_ikservo.calibration import calibrate_arm, write_lerobot_file
from lerobot_robot_ikservo.config import IkservoLeaderConfig, IkservoRobotConfig

__all__ = ["ArmConnection"]


class ArmConnection:
    """An arm that is open between ``connect`` and ``disconnect`` of a device.

    Args:
        config: Which arm, and its port.
        device: The name of the device in errors.
        on_exit: What ``close`` does with the torque.

    Attributes:
        model: The arm.
        values: Its joints as LeRobot's values.

    Raises:
        UnknownNameError: No such arm.
    """

    def __init__(
        self,
        config: IkservoRobotConfig | IkservoLeaderConfig,
        device: str,
        on_exit: OnExit = "hold",
    ) -> None:
        self._config, self._device = config, device
        self._on_exit: OnExit = on_exit
        self.model = ikservo.load_model(config.arm)
        self.values = JointValues(self.model)
        self._arm: ikservo.OpenArm | None = None

    @property
    def is_open(self) -> bool:
        """Return whether the arm is open."""
        return self._arm is not None

    @property
    def arm(self) -> ikservo.OpenArm:
        """Return the open arm.

        Raises:
            DeviceNotConnectedError: It is not open.
        """
        if self._arm is None:
            raise DeviceNotConnectedError(f"{self._device} is not connected.")
        return self._arm

    def open(self) -> None:
        """Open the arm; nothing moves and no torque changes.

        Raises:
            DeviceAlreadyConnectedError: It is open.
            IkservoError: It cannot be opened; says what to do.
        """
        if self._arm is not None:
            raise DeviceAlreadyConnectedError(f"{self._device} is connected.")
        self._arm = ikservo.open_arm(self.model, self._config.port or None)

    def calibrate(self, path: Path) -> bool:
        """Calibrate the open arm; return whether LeRobot's file was written to ``path``."""
        self.close()
        calibrate_arm(self._config)
        self.open()
        return write_lerobot_file(self.arm, path)

    def close(self) -> None:
        """Close the arm."""
        arm, self._arm = self.arm, None
        arm.close(self._on_exit)
