from abc import abstractmethod
from dataclasses import dataclass

from lerobot.device import Device, DeviceConfig


@dataclass(kw_only=True)
class RobotConfig(DeviceConfig):
    def __post_init__(self):
        pass


class Robot(Device):
    def __init__(self, config):
        super().__init__(config, "robots")
        self.robot_type = self.name

    @property
    @abstractmethod
    def observation_features(self): ...

    @abstractmethod
    def get_observation(self): ...

    @abstractmethod
    def send_action(self, action): ...
