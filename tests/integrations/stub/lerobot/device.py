"""What robots and teleoperators have in common."""

import json
import os
from pathlib import Path


class Device:
    def __init__(self, config, kind):
        self.id = config.id
        root = Path(os.environ["HF_LEROBOT_CALIBRATION"])
        self.calibration_dir = config.calibration_dir or root / kind / self.name
        self.calibration_dir.mkdir(parents=True, exist_ok=True)
        self.calibration_fpath = self.calibration_dir / f"{self.id}.json"
        self.calibration = {}

    def _load_calibration(self, fpath=None):
        self.calibration = json.loads((fpath or self.calibration_fpath).read_text())
