"""B13: the tests of this folder on faulty lines: echo, single bytes, noise before replies."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from .factories import MODES

HERE = Path(__file__).parent


@pytest.mark.campaign
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("mode", MODES)
def test_hardware_tests_pass_with_every_port_mode(mode):
    words = [sys.executable, "-m", "pytest", "-q", "-n", "auto", str(HERE), "--line", mode]
    done = subprocess.run(words, capture_output=True, text=True, cwd=HERE.parents[1], check=False)
    assert done.returncode == 0, done.stdout[-4000:]
