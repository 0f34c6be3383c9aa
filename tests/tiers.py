"""Tests that run at every save (``make test``), and those before a commit (``make test-all``).

At every save: the pure layers, servos and the bus, each command, arms in motion on one Feetech and
one Dynamixel arm, and what is marked ``smoke``: the main screens in a browser, and the files of
tests about one motion. The others are ``full``: by a mark, and here where a whole folder takes
long, the case is another arm, or the test is in ``slow_tests.txt``, which
``pytest -n auto --record-slow-tests`` writes. A path on the command line runs everything that it
names.
"""

import re
from collections import Counter
from pathlib import Path

import pytest

FULL_FOLDERS = {
    "browser", "docs", "examples", "integrations", "journeys", "portability", "tools",
}  # fmt: skip
MOVING_FOLDERS = {"api", "apps", "arm", "cli", "guard"}
OTHER_ARM = re.compile(
    r"(?<![a-z0-9])(open_manipulator_x|omx_[fl]|px1[05]0|rx150|rx200|wx200|wx250s|vx250|vx300s"
    r"|so100|planar2|planar3)(?![a-z0-9])"
)
SLOW_TESTS = Path(__file__).with_name("slow_tests.txt")
SLOW_S = 0.6  # a test that takes longer with all its cases is slow: `make test` takes 4 minutes


def add_option(parser):
    parser.addoption("--all", action="store_true", help="also what `make test` leaves out")
    parser.addoption(
        "--record-slow-tests", action="store_true", help=f"write {SLOW_TESTS.name} from this run"
    )


def choose_tier(config):
    """Run everything if paths are given; tell the workers of xdist."""
    if hasattr(config, "workerinput"):
        config.option.all = config.workerinput["all"]
    else:
        whole_suite = config.args_source is pytest.Config.ArgsSource.TESTPATHS
        if config.option.record_slow_tests and not whole_suite:
            raise pytest.UsageError("--record-slow-tests measures the whole suite: give no path")
        config.option.all = config.option.all or not whole_suite


def leave_full_tests_out(config, items):
    for item in items:
        if _is_full(item):
            item.add_marker(pytest.mark.full)
    if not config.option.record_slow_tests:
        slow = set(SLOW_TESTS.read_text(encoding="utf-8").splitlines())
        for item in items:
            if _function_id(item.nodeid) in slow and not item.get_closest_marker("smoke"):
                item.add_marker(pytest.mark.full)
    if not config.option.all:
        left_out = [item for item in items if item.get_closest_marker("full")]
        items[:] = [item for item in items if not item.get_closest_marker("full")]
        config.hook.pytest_deselected(items=left_out)


def record_slow_tests(reports):
    """Write the tests that take long and are not marked; a test counts with all its cases."""
    durations_s = Counter()
    for report in reports:
        if not {"full", "smoke"} & report.keywords.keys():
            durations_s[_function_id(report.nodeid)] += report.duration
    slow = sorted(test for test, duration_s in durations_s.items() if duration_s > SLOW_S)
    SLOW_TESTS.write_text("\n".join(slow) + "\n", encoding="utf-8")


def _function_id(node_id):
    return node_id.partition("[")[0]


def _is_full(item):
    folder = item.nodeid.split("/")[1] if item.nodeid.count("/") > 1 else ""
    if folder in FULL_FOLDERS:
        return not item.get_closest_marker("smoke")
    return folder in MOVING_FOLDERS and OTHER_ARM.search(item.name.partition("[")[2]) is not None
