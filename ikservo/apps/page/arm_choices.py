"""The arms and ports that the page offers: catalogue, own calibrations, adapters."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from ikservo.apps.page.messages.page_messages import BadMessageError
from ikservo.apps.page.served_arms import ArmAtPort
from ikservo.calibration.paths import calibration_path, calibrations_of
from ikservo.errors import IkservoError
from ikservo.hardware.port_names import remembered_serial_number
from ikservo.hardware.serial_ports import SerialAdapter, list_adapters
from ikservo.model import Model, arm_names, load_model

_SIMULATED = "sim"


@dataclass(frozen=True, slots=True)
class ArmChoices:
    """The only arms and ports that can be opened from the page.

    Attributes:
        models: The arms by name.
        ports: The remark on each port, by its name.
        own: The user's own arms: arm, adapter, and port (empty while unplugged).
    """

    models: Mapping[str, Model] = field(default_factory=dict[str, Model])
    ports: Mapping[str, str] = field(default_factory=dict[str, str])
    own: Sequence[Mapping[str, str]] = ()

    def choose(self, arm: str, port: str) -> ArmAtPort:
        """Choose one of the offered arms at one of the offered ports.

        Raises:
            BadMessageError: The arm was not offered, or is unplugged now.
        """
        if arm not in self.models:
            raise BadMessageError(f"There is no arm {arm[:64]!r} in the list.")
        self.check_port(port)
        return ArmAtPort(self.models[arm], port)

    def check_port(self, port: str) -> None:
        """Check that a port was offered.

        Raises:
            BadMessageError: The port was not offered, or is unplugged now.
        """
        if port not in self.ports:
            raise BadMessageError(f"The port {port[:64]!r} is gone.", "Is it plugged in?")

    def fields(self) -> dict[str, object]:
        """Return the choices as the page lists them."""
        return {
            "models": [[name, model.title] for name, model in self.models.items()],
            "ports": [[name, text] for name, text in self.ports.items()],
            "own": self.own,
        }


def find_choices(given: Sequence[ArmAtPort] = (), port: str | None = None) -> ArmChoices:
    """Find the present choices, with the arms and ports of the command line; open no port."""
    models = {model.name: model for model in _load_each(arm_names())}
    models |= {place.model.name: place.model for place in given}
    adapters = list_adapters()
    ports: dict[str, str] = {}
    for adapter in adapters:
        user = f", used by {adapter.used_by}" if adapter.used_by else ""
        ports[adapter.device] = f"{adapter.chip}{user}"
    named = {each for each in (*(place.port for place in given), port) if each} - set(ports)
    ports |= dict.fromkeys(sorted(named), "")
    own = [row for name in models for row in _own_arms(name, adapters)]
    return ArmChoices(models, {**ports, _SIMULATED: "simulated arm, no hardware"}, own)


def _load_each(arms: Sequence[str | Path]) -> list[Model]:
    models: list[Model] = []
    for name in arms:
        with suppress(IkservoError):  # a damaged file hides only its own arm
            models.append(load_model(name))
    return models


def _own_arms(name: str, adapters: Sequence[SerialAdapter]) -> list[dict[str, str]]:
    """Return an arm's calibrated or last used adapters, even if they are not plugged in."""
    files = set(calibrations_of(name))
    last = remembered_serial_number(name)
    rows: list[dict[str, str]] = []
    for adapter in adapters:
        file = calibration_path(name, adapter.serial_number)
        calibrated = bool(adapter.serial_number) and file in files
        if calibrated or (last and adapter.serial_number == last):
            files.discard(file)
            rows.append(_own_arm(name, adapter.serial_number, adapter.device, calibrated))
    return rows + [
        _own_arm(name, file.stem.removeprefix(name).lstrip("-"), "", True)
        for file in sorted(files)
        if file.stem.removeprefix(name).lstrip("-") != _SIMULATED
    ]


def _own_arm(name: str, adapter: str, port: str, calibrated: bool) -> dict[str, str]:
    state = "calibrated" if calibrated else "not calibrated"
    return {"arm": name, "adapter": adapter, "port": port, "state": state}


class ChoiceFinder:
    """Search for choices in a thread, because a search takes longer than a control cycle.

    Args:
        given: Arms and ports from the command line.
        port: A port from the command line that has no arm.

    Attributes:
        found: The latest choices, replaced as a whole.
    """

    def __init__(self, given: Sequence[ArmAtPort] = (), port: str | None = None) -> None:
        self._given, self._port = tuple(given), port
        self._folders: tuple[Path, ...] = ()
        self.found = ArmChoices()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Start one search; do nothing while a search is running."""
        if self._thread is None or not self._thread.is_alive():
            self._thread = threading.Thread(target=self._look, name="ikservo ports", daemon=True)
            self._thread.start()

    def wait(self) -> None:
        """Wait until the search has ended."""
        if self._thread is not None:
            self._thread.join()

    def add_folders(self, folders: Sequence[Path]) -> None:
        """Offer the arms in additional folders as well."""
        self._folders += tuple(folders)
        if folders:
            self.start()

    def _look(self) -> None:
        own = [ArmAtPort(model) for model in _load_each(self._folders)]
        self.found = find_choices([*self._given, *own], self._port)
