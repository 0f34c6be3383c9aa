"""The last line of a run of the suite."""

import subprocess
import sys
from pathlib import Path

import pytest

FROZEN = """
import gc
from ruckig import Trajectory

def test_leaves_objects_that_only_garbage_collector_frees():
    ring = [Trajectory(3)]
    ring.append(ring)
    gc.freeze()
"""


@pytest.mark.full
def test_last_line_of_test_run_is_pytest_summary(tmp_path):
    (tmp_path / "test_frozen.py").write_text(FROZEN)
    command = [sys.executable, "-m", "pytest", "-q", "-n0", "-p", "tests.conftest", str(tmp_path)]
    run = subprocess.run(
        command, cwd=Path(__file__).parents[1], stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        text=True, check=False,
    )  # fmt: skip
    assert run.stdout.splitlines()[-1].startswith("1 passed"), run.stdout
