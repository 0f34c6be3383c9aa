"""A pseudo-terminal is told from everything else that can stand behind a port's name."""

import os
import sys

import pytest

from ikservo.hardware.serial_ports import is_pseudo_terminal

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="device numbers are Linux's")


@pytest.fixture
def served():
    master, slave = os.openpty()
    yield os.ttyname(slave)
    os.close(master)
    os.close(slave)


def test_a_pseudo_terminal_is_one(served):
    assert is_pseudo_terminal(served)


def test_a_link_to_one_is_one(served, tmp_path):
    link = tmp_path / "arm"
    link.symlink_to(served)
    assert is_pseudo_terminal(str(link))


@pytest.mark.parametrize(
    "name", ["/dev/null", "/dev/ttyNONE7", "sim:", "socket://127.0.0.1:1", "COM3", "\0", ""]
)
def test_nothing_else_is_one(name):
    assert not is_pseudo_terminal(name)
