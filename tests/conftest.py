"""Options of the whole suite, and a user folder without the user's own calibrations."""

from __future__ import annotations

import gc
import os
import signal
import socket
import sys

import pytest
from hypothesis import settings

from ikservo.serving.early_stops import forget_marks
from tests import tiers
from tests.sampling import leave_others_to_campaign

# A busy machine may suspend a test at any place. A commit is judged by the same examples at each
# run; `make campaign` draws new ones.
settings.register_profile("suite", deadline=None, derandomize=True)
settings.register_profile("explore", deadline=None, print_blob=True)
settings.load_profile("suite")
# Dozens of tests start Python; they share its compiled files.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
# Shells do not set it, and with it a command that does not flush what it prints looks right.
os.environ.pop("PYTHONUNBUFFERED", None)
# Files are saved so that they survive a power cut. On a disk that takes thousands of waits, in
# memory none.
if os.access("/dev/shm", os.W_OK):
    os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", "/dev/shm")
# Threads of BLAS spin while they wait for each other. On busy cores a QR decomposition of 1200 x 60
# took a hundred times the processor time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# A shell lets background programs ignore Ctrl-C, and nohup a closed terminal. Tests must not.
for name, usual in (("SIGINT", signal.default_int_handler), ("SIGHUP", signal.SIG_DFL)):
    if signal.getsignal(getattr(signal, name, signal.SIGINT)) is signal.SIG_IGN:
        signal.signal(getattr(signal, name), usual)

CAMPAIGN_TIMEOUT_S = 3600  # of one test; `timeout` in pyproject.toml is for the others


def pytest_addoption(parser):
    tiers.add_option(parser)
    parser.addoption(
        "--real-port",
        help="serial port of a real arm, for `-m hardware`; its torque stays off",
    )
    parser.addoption(
        "--line",
        default="plain",
        choices=("plain", "echo", "bytes", "garbage"),
        help="mode of the simulated buses in tests/hardware; see factories.py",
    )
    parser.addoption("--real-arm", default="so101", help="which arm that is (default: so101)")


def pytest_configure(config):
    tiers.choose_tier(config)


@pytest.hookimpl(optionalhook=True)  # of xdist
def pytest_configure_node(node):
    node.workerinput["all"] = node.config.option.all


def pytest_terminal_summary(terminalreporter, exitstatus, config):
    if config.option.record_slow_tests and exitstatus in (0, 1):  # else the run has no end
        reports = [report for group in terminalreporter.stats.values() for report in group]
        tiers.record_slow_tests(r for r in reports if isinstance(r, pytest.TestReport))


def pytest_sessionstart():
    gc.disable()  # collection makes thousands of objects, and all of them stay


@pytest.hookimpl(optionalhook=True)  # of xdist, for ``-n auto``
def pytest_xdist_auto_num_workers():
    return (os.cpu_count() or 1) + 1  # a test in eight waits for a process, a thread or a socket


@pytest.hookimpl(tryfirst=True)  # before the markers are looked at
def pytest_collection_modifyitems(config, items):
    leave_others_to_campaign(items)
    for item in items:
        if item.get_closest_marker("campaign") and not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(CAMPAIGN_TIMEOUT_S))
    tiers.leave_full_tests_out(config, items)


def pytest_collection_finish():
    gc.freeze()
    gc.enable()


def pytest_unconfigure():
    # Ruckig reports objects that are not collected at the end as leaked, after the last line.
    gc.unfreeze()


@pytest.fixture(autouse=True, scope="session")
def _isolate_user_files(tmp_path_factory):
    os.environ["IKSERVO_HOME"] = str(tmp_path_factory.mktemp("home"))


@pytest.fixture(scope="session")
def own_address():
    """Return an address of this machine that other machines could reach."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sending:
        try:
            sending.connect(("192.0.2.1", 9))  # sends nothing
        except OSError:
            pytest.skip("no network")
        return sending.getsockname()[0]


@pytest.fixture(autouse=True)
def _forget_stops():
    """Forget stops that an earlier test requested: all tests are one program."""
    forget_marks()
