"""Options of the whole suite, and a home where no test meets the calibrations of a person."""

from __future__ import annotations

import os

import pytest


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


@pytest.fixture(autouse=True, scope="session")
def _no_persons_own_files(tmp_path_factory):
    os.environ["IKSERVO_HOME"] = str(tmp_path_factory.mktemp("home"))
