"""rustypot, a driver in Rust, exchanges packets with the servos over the pseudo-terminal."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

rustypot = pytest.importorskip("rustypot")

CONFIGS = Path(__file__).parents[2] / "configs"
SERVE = "import sys, servosim; sys.exit(servosim.serve(sys.argv[1:]))"
TIMEOUT_S = 0.2  # of each answer: the machine of a test may be busy


@pytest.fixture
def server():
    """Start servers; each returns the path of its port."""
    running = []

    def start(*argv):
        command = [sys.executable, "-c", SERVE, *map(str, argv)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        running.append(process)
        return process.stdout.readline().strip()

    yield start
    for process in running:
        process.terminate()
        process.wait(10)
        process.stdout.close()


def wait_until_at(read, goal_rad):
    """Wait until it stays there: a step without a profile overshoots."""
    start_s = away_s = time.monotonic()
    while time.monotonic() < min(away_s + 0.2, start_s + 5.0):
        if abs(read() - goal_rad) > 0.01:
            away_s = time.monotonic()
    return read()


@pytest.mark.full
def test_rustypot_pings_reads_and_moves_sts_servos(server):
    path = server(CONFIGS / "so101" / "arm.toml", "--pose", "home")
    bus = rustypot.Sts3215PyController(path, 1_000_000, TIMEOUT_S)
    assert [bus.ping(id_) for id_ in (1, 6)] == [True, True]
    assert len(bus.sync_read_present_position([1, 2, 3, 4, 5, 6])) == 6
    bus.write_goal_position(1, 0.0)
    bus.write_torque_enable(1, True)
    bus.sync_write_goal_position([1], [0.4])
    assert wait_until_at(lambda: bus.read_present_position(1)[0], 0.4) == pytest.approx(
        0.4, abs=0.01
    )


def test_rustypot_pings_reads_and_reboots_x_servos(server):
    path = server(CONFIGS / "koch" / "arm.toml", "--pose", "home")
    bus = rustypot.Xl430PyController(path, 1_000_000, TIMEOUT_S)
    assert [bus.ping(id_) for id_ in (1, 2)] == [True, True]
    assert bus.sync_read_present_position([1])[0] == pytest.approx(2048, abs=3)
    assert bus.reboot(2)


def test_rustypot_moves_scs_servo(server):
    path = server("--servo", "1:scs0009")
    bus = rustypot.Scs0009PyController(path, 1_000_000, TIMEOUT_S)
    bus.write_torque_enable(1, 1)
    bus.write_goal_position(1, 0.5)
    assert wait_until_at(lambda: bus.read_present_position(1)[0], 0.5) == pytest.approx(
        0.5, abs=0.02
    )


def test_rustypot_moves_mx_servo(server):
    path = server("--servo", "1:mx-28", "--baud", "1000000")
    bus = rustypot.MxPyController(path, 1_000_000, TIMEOUT_S)
    bus.write_torque_enable(1, True)
    bus.write_goal_position(1, 0.5)
    assert wait_until_at(lambda: bus.read_present_position(1)[0], 0.5) == pytest.approx(
        0.5, abs=0.02
    )
