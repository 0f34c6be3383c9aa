"""Open, calibrate and close the arm of a LeRobot robot or teleoperator."""

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
    """An arm that is open from ``connect`` to ``disconnect`` of a device.

    Args:
        config: Names the arm and its port.
        device: The name of the device for error messages.
        on_exit: The torque after ``close``: ``hold`` or ``relax``.

    Attributes:
        model: The arm.
        values: Converts the joints to LeRobot's values.

    Raises:
        UnknownNameError: There is no such arm.
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
            DeviceNotConnectedError: The arm is not open.
        """
        if self._arm is None:
            raise DeviceNotConnectedError(f"{self._device} is not connected.")
        return self._arm

    def open(self) -> None:
        """Open the arm; nothing moves and no torque changes.

        Raises:
            DeviceAlreadyConnectedError: The arm is already open.
            IkservoError: The arm cannot be opened; the message says what to do.
        """
        if self._arm is not None:
            raise DeviceAlreadyConnectedError(f"{self._device} is already connected.")
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
