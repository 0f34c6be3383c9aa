"""Commands limit BLAS to one thread, unless the user has set another number."""

import os
import subprocess
import sys

import pytest

CODE = """
import os, sys
from pathlib import Path
from ikservo.cli import entry_point
assert "numpy" not in sys.modules
def report(code):
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")
    threads = len(list(Path("/proc/self/task").glob("*")))
    print(code, *(os.environ.get(name) for name in names), threads)
os._exit = report
sys.argv[1:] = ["solve", "0.25", "0.05", "0.15", "--arm", "so101", "--json"]
entry_point.console()
"""


def report_of_solve(**own):
    """Return exit code, the thread counts that BLAS reads, and the number of threads."""
    environment = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    done = subprocess.run(
        [sys.executable, "-c", CODE],
        env=environment | own,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.splitlines()[-1].split()


@pytest.mark.skipif(sys.platform != "linux", reason="counts threads in /proc")
def test_command_uses_one_blas_thread():
    assert report_of_solve() == ["0", "1", "None", "1"]


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("own", "read"),
    [
        ({"OPENBLAS_NUM_THREADS": "2"}, ["2", "None"]),
        ({"OMP_NUM_THREADS": "2"}, ["None", "2"]),
        ({"OPENBLAS_NUM_THREADS": ""}, ["", "None"]),
    ],
)
def test_blas_thread_count_set_by_user_is_kept(own, read):
    assert report_of_solve(**own)[1:-1] == [each for each in read if each]
