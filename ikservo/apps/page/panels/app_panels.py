"""Panels that other apps add to the page: rows of text, and buttons for their motions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, cast

from ikservo.app import Panel
from ikservo.app_discovery import all_apps, load_place
from ikservo.apps.page.messages.page_messages import BadMessageError
from ikservo.apps.page.running.arm_job import JobObserver, refusals_logged
from ikservo.apps.page.running.arm_thread import ArmThread
from ikservo.apps.page.server.message_age_and_rate import Client
from ikservo.apps.page.server.server import Frame
from ikservo.arm import Arm
from ikservo.clock import Clock
from ikservo.model import Model
from ikservo.planning.motions import MotionValue

_PERIOD_S = 0.5  # least time between two updates of the texts

MakePanel = Callable[[Model, Mapping[str, float]], Panel]


class RunMotion:
    """Job that runs the motion that a panel button offers (``ArmJob``).

    Args:
        title: The text of the button.
        motion: The motion; it calls ``on_progress`` in each cycle, so that the page can stop it.
    """

    is_planned = True

    def __init__(self, title: str, motion: MotionValue[Any]) -> None:
        self.title, self._motion = title, motion

    def run(self, arm: Arm, observer: JobObserver) -> None:
        """Execute the motion. If it is refused before the arm moves, nothing has to be stopped.

        Raises:
            IkservoError: The motion failed; the arm holds until the failure is acknowledged.
        """
        with refusals_logged(arm, observer):
            arm.execute(self._motion, observer.on_progress)


class AppPanels:
    """The panels of all apps; a panel that fails is replaced by its error."""

    def __init__(self, arm_thread: ArmThread, clock: Clock) -> None:
        self._arm_thread, self._clock = arm_thread, clock
        self._places = {k: v for app in all_apps() for k, v in app.panels.items()}
        self._panels: dict[str, Panel] = {}
        self._updated_s = -math.inf

    def frames(self, client: Client, own: Mapping[str, Panel]) -> list[Frame]:
        """Return the page's ``own`` panels and the panels of all apps, if new for a client."""
        now_s = self._clock.now_s()
        if self._places and now_s - self._updated_s >= _PERIOD_S:
            self._updated_s = now_s
            arm = self._arm_thread.arm
            positions = arm.joint_index.by_name(self._arm_thread.snapshot.measured)
            panels: dict[str, Panel] = {}
            for name, place in self._places.items():
                try:
                    make: MakePanel = load_place(place)
                    panel = make(arm.model, positions)
                    rows = [(str(key), str(value)) for key, value in panel.rows]
                    panels[name] = Panel(rows, panel.motions)
                except Exception as error:  # another app may raise anything
                    panels[name] = Panel([("error", f"{type(error).__name__}: {error}")])
            self._panels = panels
        shown = [
            {"heading": name, "rows": list(panel.rows), "buttons": list(panel.motions)}
            for name, panel in {**own, **self._panels}.items()
        ]
        if not shown and "app_panels" not in client.sent:
            return []
        return client.unsent({"kind": "app_panels", "panels": shown})

    def start(self, heading: str, button: str) -> None:
        """Start the motion that a button offers.

        Raises:
            BadMessageError: There is no such button.
            InputError: The arm is busy or was stopped.
        """
        panel = self._panels.get(heading, Panel())
        motion: object = panel.motions.get(button)
        if not isinstance(motion, MotionValue):
            raise BadMessageError(f"{heading} has no button {button!r}.", "Reload the page.")
        self._arm_thread.request_job(RunMotion(button, cast("MotionValue[Any]", motion)))
