from abc import ABC
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lerobot.registry import ChoiceRegistry

@dataclass(kw_only=True)
class TeleoperatorConfig(ChoiceRegistry):
    id: str | None = None
    calibration_dir: Path | None = None

class Teleoperator(ABC):
    config_class: type[Any]
    name: str
    id: str | None
    calibration_fpath: Path
    def __init__(self, config: TeleoperatorConfig) -> None: ...
    def _load_calibration(self, fpath: Path | None = None) -> None: ...
