from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path

from lerobot.device import Device
from lerobot.registry import ChoiceRegistry


@dataclass(kw_only=True)
class RobotConfig(ChoiceRegistry):
    id: str | None = None
    calibration_dir: Path | None = None

    def __post_init__(self):
        pass


class Robot(Device, ABC):
    def __init__(self, config):
        super().__init__(config, "robots")
        self.robot_type = self.name

    @property
    @abstractmethod
    def observation_features(self): ...

    @property
    @abstractmethod
    def action_features(self): ...

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
    def get_observation(self): ...

    @abstractmethod
    def send_action(self, action): ...

    @abstractmethod
    def disconnect(self): ...
