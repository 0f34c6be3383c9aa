"""The same packets through a pseudo-terminal that another process serves, in real time."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from ikservo.errors import PortBusyError, PortLostError
from ikservo.hardware import ServoBus, ServoSpec, open_port, torque_on
from ikservo.registers import RegisterName, control_table

pytest.importorskip("pty", reason="pseudo-terminals are a Unix thing")

CONFIGS = Path(__file__).parents[2] / "configs"
SERVE = "import sys, servosim; sys.exit(servosim.serve(sys.argv[1:]))"


@pytest.fixture
def served():
    """Serve simulated arms by name; yield the ports."""
    servers = []

    def serve(arm):
        command = [sys.executable, "-c", SERVE, str(CONFIGS / arm / "arm.toml")]
        server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        servers.append(server)
        return server.stdout.readline().split()[-1], server

    yield serve
    for server in servers:
        server.terminate()
        server.communicate(timeout=10)


@pytest.mark.parametrize(
    ("arm", "model", "ids"),
    [("so101", "STS3215", range(1, 7)), ("open_manipulator_x", "XM430-W350", range(11, 16))],
)
def test_served_arm_answers_ping_and_torque_on(served, arm, model, ids):
    name, _ = served(arm)
    servos = [ServoSpec(i, control_table(model)) for i in ids]
    with ServoBus(open_port(name, 1_000_000), servos) as bus:
        assert {bus.ping(i).model_number for i in ids} == {control_table(model).number}
        held_tick = torque_on(bus, ids[0])
        assert (
            bus.sync_read(ids, RegisterName.GOAL_POSITION, raw=True).require_all()[ids[0]]
            == held_tick
        )


def test_second_open_of_served_port_is_refused_as_busy(served):
    name, _ = served("so101")
    with open_port(name, 1_000_000), pytest.raises(PortBusyError):
        open_port(name, 1_000_000)


def test_server_shutdown_raises_port_lost_error(served):
    name, server = served("so101")
    with ServoBus(open_port(name, 1_000_000), [ServoSpec(1, control_table("STS3215"))]) as bus:
        bus.ping(1)
        server.terminate()
        server.wait(timeout=10)
        with pytest.raises(PortLostError, match="Lost connection"):
            bus.read(1, RegisterName.PRESENT_POSITION)
