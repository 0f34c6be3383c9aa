"""A pseudo-terminal is distinguished from all other kinds of ports."""

import os
import sys

import pytest

from ikservo.errors import ServoSilentError
from ikservo.hardware import ServoBus, ServoSpec
from ikservo.hardware.port import open_port
from ikservo.hardware.serial_ports import is_pseudo_terminal, line_hint
from ikservo.registers import MODELS

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="device numbers are Linux's")


@pytest.fixture
def served():
    master, slave = os.openpty()
    yield os.ttyname(slave)
    os.close(master)
    os.close(slave)


def test_pseudo_terminal_is_recognised(served):
    assert is_pseudo_terminal(served)


def test_link_to_pseudo_terminal_is_recognised(served, tmp_path):
    link = tmp_path / "arm"
    link.symlink_to(served)
    assert is_pseudo_terminal(str(link))


@pytest.mark.parametrize(
    "name", ["/dev/null", "/dev/ttyNONE7", "sim:", "socket://127.0.0.1:1", "COM3", "\0", ""]
)
def test_other_port_names_are_not_pseudo_terminals(name):
    assert not is_pseudo_terminal(name)


def test_hints_for_simulated_bus_do_not_mention_cables(served):
    servo = ServoSpec(1, MODELS["STS3215"])
    with (
        ServoBus(open_port(served, 1_000_000), [servo]) as bus,
        pytest.raises(ServoSilentError, match=r"no plugs\. Reduce the computer's load"),
    ):
        bus.read(1, servo.table.registers["homing_offset"])
    assert line_hint("/dev/ttyUSB0", "Check the plugs.") == "Check the plugs."
