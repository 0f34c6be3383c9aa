from abc import abstractmethod
from dataclasses import dataclass

from lerobot.device import Device, DeviceConfig


@dataclass(kw_only=True)
class TeleoperatorConfig(DeviceConfig):
    pass


class Teleoperator(Device):
    def __init__(self, config):
        super().__init__(config, "teleoperators")

    @property
    @abstractmethod
    def feedback_features(self): ...

    @abstractmethod
    def get_action(self): ...

    @abstractmethod
    def send_feedback(self, feedback): ...
