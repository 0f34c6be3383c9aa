"""Two processes and a pseudo-terminal: the whole chain, judged by the vendors' SDKs."""

import os
import signal
import subprocess
import sys
from contextlib import ExitStack, contextmanager

import dynamixel_sdk
import numpy as np
import pytest
import scservo_sdk

from tests.oracle import arm_file, tip_from_ticks

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no ptys")

IKSERVO = [sys.executable, "-c", "import sys; from ikservo.cli import main; sys.exit(main())"]
# Not far from where each lies at rest: these motions take as long as they would on a table.
TARGETS_M = {"so101": (0.22, 0.03, 0.08), "open_manipulator_x": (0.15, 0.03, 0.09)}


@contextmanager
def served(arm):
    """Run ``ikservo sim ARM`` and yield the port it prints."""
    process = subprocess.Popen([*IKSERVO, "sim", arm], stdout=subprocess.PIPE, text=True)
    with process:
        try:
            yield process.stdout.readline().strip(), process
        finally:
            process.send_signal(signal.SIGTERM)


@pytest.fixture(scope="module")
def port_of():
    """Return a function that gives an arm's port; the file shares one simulator per arm."""
    with ExitStack() as stack:
        ports = {}

        def find(arm):
            if arm not in ports:
                ports[arm], _ = stack.enter_context(served(arm))
            return ports[arm]

        yield find


def run_until_settled(run_cli, words):
    """Run a command; repeat it if a busy computer stopped the arm: silence (4), late cycles (8)."""
    for _ in range(12):
        done = run_cli(words)
        if done.code not in (4, 8):
            break
    return done


def ticks_by_the_vendors_sdk(arm, port):
    """Read every servo's position with a vendor's SDK and none of our code."""
    if arm_file(arm)["bus"]["family"] == "feetech_sts":
        handler, packets = scservo_sdk.PortHandler(port), scservo_sdk.PacketHandler(0)
        read = lambda i: packets.read2ByteTxRx(handler, i, 56)  # noqa: E731
    else:
        handler, packets = dynamixel_sdk.PortHandler(port), dynamixel_sdk.PacketHandler(2.0)
        read = lambda i: packets.read4ByteTxRx(handler, i, 132)  # noqa: E731
    assert handler.openPort()
    assert handler.setBaudRate(1_000_000)
    try:
        ticks = {}
        for joint in arm_file(arm)["joints"]:
            servo_id = joint["servo"]["id"]
            ticks[servo_id] = read_in_time(read, servo_id)
        return ticks
    finally:
        handler.closePort()


def read_in_time(read, servo_id):
    """Read again if a busy computer delayed the simulator for longer than the SDK waits."""
    for _ in range(12):
        tick, result, error = read(servo_id)
        if result not in (dynamixel_sdk.COMM_RX_TIMEOUT, scservo_sdk.COMM_RX_TIMEOUT):
            break
    assert (result, error) == (0, 0)
    return tick


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize(("arm", "target_m"), TARGETS_M.items())
def test_vendor_sdk_confirms_move_over_pseudo_terminal(run_cli, port_of, arm, target_m):
    point = " ".join(map(str, target_m))
    done = run_until_settled(run_cli, f"move {point} --arm {arm} --port {port_of(arm)} --json")
    assert done.code == 0, done.err
    tip_m = tip_from_ticks(arm, ticks_by_the_vendors_sdk(arm, port_of(arm)))
    np.testing.assert_allclose(tip_m, target_m, atol=2e-3)
    np.testing.assert_allclose(done.json["measured_tip_m"], tip_m, atol=1e-3)


def test_port_in_use_is_refused_with_exit_code_3(run_cli, port_of):
    port = port_of("so101")
    holder = os.open(port, os.O_RDWR | os.O_NOCTTY)
    try:
        import fcntl
        import termios

        fcntl.flock(holder, fcntl.LOCK_EX)
        fcntl.ioctl(holder, termios.TIOCEXCL)
        done = run_cli(f"where --arm so101 --port {port}")
    finally:
        fcntl.ioctl(holder, termios.TIOCNXCL)
        os.close(holder)
    assert done.code == 3
    assert "in use" in done.err


@pytest.mark.full
def test_lost_port_server_exits_with_3_without_traceback(run_cli):
    with served("so101") as (port, process):
        process.send_signal(signal.SIGTERM)
        process.wait(timeout=20)
        done = run_cli(f"where --arm so101 --port {port}")
    assert done.code == 3
    assert "Traceback" not in done.err


@pytest.mark.campaign  # tests/journeys/test_bad_day.py presses Ctrl-C in a terminal
def test_ctrl_c_over_pseudo_terminal_holds_arm_and_exits_130(run_cli, port_of):
    port = port_of("so101")
    before = pan_of(run_cli, port)
    words = ["joints", "shoulder_pan=100", "--arm", "so101", "--port", port, "--speed", "slow"]
    words += ["--no-collision"]  # a limp arm has sunk onto the table
    moving = subprocess.Popen([*IKSERVO, *words], stderr=subprocess.PIPE, text=True)
    with moving:
        while "slow" not in moving.stderr.readline():
            pass
        _wait_until_it_moves(run_cli, port, moving, before["position_rad"])
        moving.send_signal(signal.SIGINT)
        outcome = moving.stderr.read()
    pan = pan_of(run_cli, port)
    assert moving.returncode == 130
    assert "torque stays on" in outcome
    assert pan["torque"] is True
    assert before["position_rad"] < pan["position_rad"] < 1.7


def pan_of(run_cli, port):
    return run_until_settled(run_cli, f"where --arm so101 --port {port} --json").json["joints"][0]


def _wait_until_it_moves(run_cli, port, process, start_rad):
    """Wait until the process that has the port reports that the joint moves."""
    while process.poll() is None:
        seen = run_cli(f"where --arm so101 --port {port} --json")
        if seen.code == 0 and seen.json["joints"][0]["position_rad"] > start_rad + 0.05:
            return
    pytest.fail("the motion has ended")
