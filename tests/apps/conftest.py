"""Fixtures for tests of the apps' commands."""

import pytest

from tests.calibration.narrow_arm import write_narrow_arm
from tests.cli.conftest import run_cli

__all__ = ["run_cli"]


@pytest.fixture(scope="module")
def narrow(tmp_path_factory):
    """Return the file of an arm whose search for its stops is short."""
    return write_narrow_arm(tmp_path_factory.mktemp("narrow"))
