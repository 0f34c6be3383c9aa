"""The common base of robots and teleoperators."""

import json
import os
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path

from lerobot.registry import ChoiceRegistry


@dataclass(kw_only=True)
class DeviceConfig(ChoiceRegistry):
    id: str | None = None
    calibration_dir: Path | None = None


class Device(ABC):
    def __init__(self, config, kind):
        self.id = config.id
        root = Path(os.environ["HF_LEROBOT_CALIBRATION"])
        self.calibration_dir = config.calibration_dir or root / kind / self.name
        self.calibration_dir.mkdir(parents=True, exist_ok=True)
        self.calibration_fpath = self.calibration_dir / f"{self.id}.json"
        self.calibration = {}

    def _load_calibration(self, fpath=None):
        self.calibration = json.loads((fpath or self.calibration_fpath).read_text())

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
    def disconnect(self): ...
