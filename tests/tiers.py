"""Tests that run at every save (``make test``), and those before a commit (``make test-all``).

At every save: the pure layers, servos and the bus, each command, arms in motion on one Feetech and
one Dynamixel arm, and browser tests of the main screens (``smoke``). The others are marked
``full``: by hand if one test takes long, and here if a whole folder does or the case is another
arm. A path on the command line runs everything that it names.
"""

import re

import pytest

FULL_FOLDERS = {
    "browser", "docs", "examples", "integrations", "journeys", "portability", "tools",
}  # fmt: skip
MOVING_FOLDERS = {"api", "apps", "arm", "cli", "guard"}
OTHER_ARM = re.compile(
    r"(?<![a-z0-9])(open_manipulator_x|omx_[fl]|px1[05]0|rx150|rx200|wx200|wx250s|vx250|vx300s"
    r"|so100|planar2|planar3)(?![a-z0-9])"
)


def add_option(parser):
    parser.addoption("--all", action="store_true", help="also what `make test` leaves out")


def choose_tier(config):
    """Run everything if paths are given; tell the workers of xdist."""
    if hasattr(config, "workerinput"):
        config.option.all = config.workerinput["all"]
    else:
        whole_suite = config.args_source is pytest.Config.ArgsSource.TESTPATHS
        config.option.all = config.option.all or not whole_suite


def leave_full_tests_out(config, items):
    for item in items:
        if _is_full(item):
            item.add_marker(pytest.mark.full)
    if not config.option.all:
        left_out = [item for item in items if item.get_closest_marker("full")]
        items[:] = [item for item in items if not item.get_closest_marker("full")]
        config.hook.pytest_deselected(items=left_out)


def _is_full(item):
    folder = item.nodeid.split("/")[1] if item.nodeid.count("/") > 1 else ""
    if folder in FULL_FOLDERS:
        return not item.get_closest_marker("smoke")
    return folder in MOVING_FOLDERS and OTHER_ARM.search(item.name.partition("[")[2]) is not None
