"""``ikservo stop`` in one process ends a motion in another, whichever command it is."""

import os
import subprocess
import sys
from contextlib import contextmanager

import pytest

from ikservo.arm.opening import open_bus
from ikservo.arm.other_process import query_state
from ikservo.clock import RealClock
from ikservo.errors import PortError
from ikservo.model import load_model
from ikservo.registers import RegisterName
from tests.cli.test_over_a_pty import IKSERVO, served

pytestmark = [
    pytest.mark.full,
    pytest.mark.skipif(sys.platform == "win32", reason="Windows has no ptys"),
]

SO101 = load_model("so101")
COMMANDS = {
    "joints": "joints shoulder_pan=90 --speed slow --yes --arm so101",
    "calibrate --auto": "calibrate so101 --auto --yes",
    "calibrate --wiggle": "calibrate so101 --wiggle --yes",
    "servo tune": "servo tune --suggest --yes --arm so101 --id shoulder_pan",
    "identify": "identify --quick --yes --arm so101",
}


@pytest.fixture(scope="module")
def port():
    with served("so101") as (port, _):
        yield port


@contextmanager
def running(words, port, log):
    with (
        log.open("w") as output,
        subprocess.Popen(
            [*IKSERVO, *words.split(), "--port", port],
            stdin=subprocess.DEVNULL, stdout=output, stderr=output, env=dict(os.environ),
        ) as process,
    ):  # fmt: skip
        try:
            yield process
        finally:
            process.kill()


def wait_until_moving(port, process, log):
    """Wait until a joint with torque has moved by a degree since the state before."""
    before, clock = {}, RealClock()
    while process.poll() is None:
        try:
            state = query_state(SO101, port)
        except PortError:  # its port is open, and no arm yet
            state = None
        if state is not None and any(joint.torque for joint in state.joints):
            if any(abs(before.get(n, at) - at) > 0.01 for n, at in state.positions.items()):
                return
            before = before or state.positions
        clock.sleep_until(clock.now_s() + 0.05)
    raise AssertionError(log.read_text())


def read_ticks(port):
    with open_bus(SO101, port) as bus:
        found = bus.sync_read(bus.servos, RegisterName.PRESENT_POSITION, raw=True)
        return found.require_all()


@pytest.mark.timeout(180)
@pytest.mark.parametrize("words", COMMANDS.values(), ids=COMMANDS)
def test_stop_command_ends_motion_of_other_process(port, tmp_path, monkeypatch, words):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))
    log = tmp_path / "log"
    with running(words, port, log) as process:
        wait_until_moving(port, process, log)
        stop = subprocess.run([*IKSERVO, "stop"], check=False, capture_output=True, text=True)
        assert (stop.returncode, "stopped" in stop.stdout) == (0, True), stop.stderr
        assert process.wait(20) == 130, log.read_text()
    assert "Stopped from another terminal" in log.read_text()
    first, second = read_ticks(port), read_ticks(port)
    assert all(abs(tick - second[i]) <= 1 for i, tick in first.items())
