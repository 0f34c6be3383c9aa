"""A short recording around the pose home, as written by `ikservo record`."""

import shutil
import tempfile
from functools import cache
from pathlib import Path

import ikservo


def write_wave_recording(arm, path):
    """Write a recording of an arm to a path."""
    shutil.copy(_recorded(arm), path)


@cache
def _recorded(arm):
    path = Path(tempfile.mkdtemp()) / "wave.jsonl"
    with ikservo.open_arm(arm, port="sim:?pose=home") as machine:
        machine.enable()
        machine.record(path, duration_s=0.3)
    return path
