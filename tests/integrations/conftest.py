"""The plug-in for LeRobot with stub classes of LeRobot: torch is not needed."""

import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "stub"), str(HERE.parent.parent / "integrations" / "lerobot")]


@pytest.fixture(autouse=True)
def folders(monkeypatch, tmp_path):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", str(tmp_path / "lerobot"))
    return tmp_path
