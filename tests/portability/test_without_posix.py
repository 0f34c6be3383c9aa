"""The core works without the parts of Python that only POSIX systems have."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.portability.without_posix import MODULES

HERE = Path(__file__).parent
ROOT = HERE.parents[1]


@pytest.fixture(scope="module")
def output(tmp_path_factory):
    """Return the output of the cases in a Python without POSIX."""
    home = str(tmp_path_factory.mktemp("home"))
    command = ["-m", "tests.portability.without_posix", str(HERE / "core_cases.py")]
    done = subprocess.run(
        [sys.executable, *command], cwd=ROOT, capture_output=True, text=True, check=False,
        env=os.environ | {"IKSERVO_HOME": home, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.parametrize(
    "case",
    ["solve", "move", "view", "arms", "ports", "calibrate", "doctor", "relax", "lock", "sim"],
)
def test_core_works_without_posix_modules(output, case):
    assert f"works: {case}" in output


def test_core_does_not_import_posix_modules_without_posix(output):
    loaded = next(line for line in output if line.startswith("modules: ")).split()[1:]
    assert not MODULES & set(loaded)
