"""Options of the whole suite, and a home where no test meets the calibrations of a person."""

from __future__ import annotations

import gc
import os
import signal
import sys

import pytest

# Dozens of tests start Python anew: what one of them has compiled, the next need not.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
# Files are saved so that they outlast a power cut: thousands of waits for a disk, none for memory.
if os.access("/dev/shm", os.W_OK):
    os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", "/dev/shm")

# A shell lets what it starts in the background ignore Ctrl-C, and nohup a terminal that is closed:
# so would all that is tested.
for name, usual in (("SIGINT", signal.default_int_handler), ("SIGHUP", signal.SIG_DFL)):
    if signal.getsignal(getattr(signal, name, signal.SIGINT)) is signal.SIG_IGN:
        signal.signal(getattr(signal, name), usual)


def pytest_addoption(parser):
    parser.addoption(
        "--real-port",
        help="serial port of a real arm, for `-m hardware`; its torque stays off",
    )
    parser.addoption(
        "--line",
        default="plain",
        choices=("plain", "echo", "bytes", "rubbish"),
        help="how tests/hardware hears its simulated lines; see desk.py",
    )
    parser.addoption("--real-arm", default="so101", help="which arm that is (default: so101)")


def pytest_sessionstart():
    gc.disable()  # thousands of tests are gathered, and none is thrown away


def pytest_collection_finish():
    gc.freeze()
    gc.enable()


@pytest.fixture(autouse=True, scope="session")
def _no_persons_own_files(tmp_path_factory):
    os.environ["IKSERVO_HOME"] = str(tmp_path_factory.mktemp("home"))
