from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path

from lerobot.device import Device
from lerobot.registry import ChoiceRegistry


@dataclass(kw_only=True)
class TeleoperatorConfig(ChoiceRegistry):
    id: str | None = None
    calibration_dir: Path | None = None


class Teleoperator(Device, ABC):
    def __init__(self, config):
        super().__init__(config, "teleoperators")

    @property
    @abstractmethod
    def action_features(self): ...

    @property
    @abstractmethod
    def feedback_features(self): ...

    @property
    @abstractmethod
    def is_connected(self): ...

    @abstractmethod
    def connect(self, calibrate=True): ...

    @property
    @abstractmethod
    def is_calibrated(self): ...

    @abstractmethod
    def calibrate(self): ...

    @abstractmethod
    def configure(self): ...

    @abstractmethod
    def get_action(self): ...

    @abstractmethod
    def send_feedback(self, feedback): ...

    @abstractmethod
    def disconnect(self): ...
