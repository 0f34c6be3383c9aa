"""``--teleop.type=ikservo_page``: a simulated arm, dragged in a browser, leads a robot."""

from __future__ import annotations

import logging
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from lerobot.teleoperators import Teleoperator
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

import ikservo
from ikservo.apps.teaching.lerobot_values import JointValues
from lerobot_robot_ikservo.config import IkservoPageConfig

if TYPE_CHECKING:
    from ikservo.apps.page.page_app import ViewApp

__all__ = ["IkservoPage"]

_LOG = logging.getLogger(__name__)


class IkservoPage(Teleoperator):
    """Serves ikservo's page, whose simulated arm is the leader.

    Args:
        config: See ``IkservoPageConfig``.

    Attributes:
        url: The address of the page with its key; empty before ``connect``.
    """

    config_class = IkservoPageConfig
    name = "ikservo_page"

    def __init__(self, config: IkservoPageConfig) -> None:
        super().__init__(config)
        self.config, self.url = config, ""
        self._model = ikservo.load_model(config.arm)
        self._model.pose(config.pose)  # raises if there is none
        self._values = JointValues(self._model)
        self._app: ViewApp | None = None
        self._last: dict[str, float] = {}
        self._open = ExitStack()

    @property
    def action_features(self) -> dict[str, type]:
        """Return one value per joint."""
        return self._values.features

    @property
    def feedback_features(self) -> dict[str, type]:
        """Return an empty mapping, because there is no feedback."""
        return {}

    @property
    def is_connected(self) -> bool:
        """Return whether the page is served."""
        return self._app is not None

    @property
    def is_calibrated(self) -> bool:
        """Return True, because a simulated arm is always calibrated."""
        return True

    def connect(self, calibrate: bool = True) -> None:
        """Serve the page and log its address.

        Raises:
            DeviceAlreadyConnectedError: The page is already served.
            PortError: The address is in use.
        """
        if self._app is not None:
            raise DeviceAlreadyConnectedError(f"{self} is already connected.")
        from ikservo.apps.page.page_app import ViewApp  # noqa: PLC0415  # the extra `page`
        from ikservo.apps.page.served_arms import ArmAtPort  # noqa: PLC0415

        place = ArmAtPort(self._model, f"sim:?pose={self.config.pose}")
        app = ViewApp([place], self.config.listen, self.config.http_port)
        self.url = self._open.enter_context(app).control
        self._open.enter_context(app.serve_in_thread())
        self._app = app
        self.get_action()
        _LOG.warning("Open this page, switch Live on, and drag the arm: %s", self.url)

    def calibrate(self) -> None:
        """Do nothing."""

    def configure(self) -> None:
        """Do nothing."""

    def get_action(self) -> dict[str, float]:
        """Return the joints of the simulated arm, or the last joints if the page has closed it."""
        if self._app is None:
            raise DeviceNotConnectedError(f"{self} is not connected.")
        leading = self._app.arms.find(self._model.name)
        if leading is not None:
            measured = leading.arm_thread.snapshot.measured
            self._last = self._values.from_positions(measured)
        return dict(self._last)

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Do nothing."""

    def disconnect(self) -> None:
        """Stop serving the page."""
        if self._app is None:
            raise DeviceNotConnectedError(f"{self} is not connected.")
        self._app, self.url = None, ""
        self._open.close()
