"""A scripted serial port: every byte sent and received is given beforehand."""

from __future__ import annotations

import os
import tomllib
from collections import deque
from pathlib import Path

import pytest

from ikservo.hardware import Port, ServoBus, ServoSpec, open_port
from ikservo.hardware.late_replies import AdaptiveTimeout, LineHealth
from ikservo.registers import STS3215, XL430W250, control_table

from .factories import PortMode

_BYTE_FOR_BYTE = {"line", "stock_port"}  # their scripts are byte for byte


def pytest_configure(config):
    PortMode.name = config.getoption("--line")


def pytest_collection_modifyitems(items):
    for item in items:
        if PortMode.name != "plain" and _BYTE_FOR_BYTE.intersection(
            getattr(item, "fixturenames", ())
        ):
            item.add_marker(pytest.mark.skip(reason="every byte is written down"))


@pytest.fixture
def plain_line():
    """Skip a test of timing on ports with added faults."""
    if PortMode.name != "plain":
        pytest.skip("needs a port without added faults")


class ManualClock:
    """Time that advances only in `sleep_until`."""

    def __init__(self):
        self.s = 0.0

    def now_s(self):
        return self.s

    def sleep_until(self, deadline_s):
        self.s = max(self.s, deadline_s)


class ScriptedLine:
    """Behaves like pyserial's Serial: checks what is sent, returns the script's replies."""

    is_open = True

    def __init__(self):
        self.clock = ManualClock()
        self.baudrate, self.timeout = 1_000_000, 0.0
        self.script = deque()  # (bytes that must be sent, [(delay in s, bytes that come back)])
        self.arriving = []  # (when, bytes)
        self.sent = []
        self.reads = 0

    def expect(self, sent, *replies, after_s=0.0005):
        """Expect these bytes to be sent next, and give the replies, in hex."""
        self.script.append((bytes.fromhex(sent), [(after_s, bytes.fromhex(r)) for r in replies]))
        return self

    def add_stale(self, stale, at_s=0.0):
        """Put unrequested bytes into the input, now or later."""
        self.arriving.append((at_s, bytes.fromhex(stale)))

    def write(self, data):
        data = bytes(data)
        assert self.script, f"nothing should be sent, but {data.hex(' ')} was"
        expected, replies = self.script.popleft()
        assert data.hex(" ") == expected.hex(" ")
        self.sent.append(data)
        self.arriving += [(self.clock.s + delay_s, reply) for delay_s, reply in replies]
        return len(data)

    @property
    def _arrived(self):
        return b"".join(data for when, data in self.arriving if when <= self.clock.s)

    @property
    def in_waiting(self):
        return len(self._arrived)

    def read(self, size=1):
        self.reads += 1
        deadline_s = self.clock.s + (self.timeout or 0.0)
        for when, _ in sorted(self.arriving):
            if self.in_waiting >= size or when > deadline_s:
                break
            self.clock.sleep_until(when)
        if self.in_waiting < size:
            self.clock.sleep_until(deadline_s)
        return self._take(size)

    def _take(self, size):
        arrived, later = self._arrived, [a for a in self.arriving if a[0] > self.clock.s]
        taken, rest = arrived[:size], arrived[size:]
        self.arriving = ([(self.clock.s, rest)] if rest else []) + later
        return taken

    def reset_input_buffer(self):
        self._take(self.in_waiting)

    def flush(self):
        pass

    def close(self):
        self.is_open = False


@pytest.fixture
def line():
    """Yield a scripted port; the whole script must have been used at the end."""
    line = ScriptedLine()
    yield line
    assert not line.script, f"never sent: {[sent.hex(' ') for sent, _ in line.script]}"


@pytest.fixture
def port(line):
    """Return a port on the script, in a clean state and with a short timeout."""
    port = Port(line, "scripted", 1_000_000)
    port.health, port.reply_timeout = LineHealth(clean_requests=0), AdaptiveTimeout(0.001, 0.001)
    return port


@pytest.fixture
def feetech(port):
    """Return a bus with two STS3215, without retries."""
    names = {1: "shoulder_pan", 2: "shoulder_lift"}
    return ServoBus(port, [ServoSpec(i, STS3215, name) for i, name in names.items()], retries=0)


@pytest.fixture
def dynamixel(port):
    """Return a bus with two XL430, without retries."""
    names = {1: "waist", 2: "shoulder"}
    return ServoBus(
        port, [ServoSpec(i, XL430W250, name) for i, name in names.items()], retries=0, fast=False
    )


@pytest.fixture
def stock_port(line):
    """Return a vendor's port handler on the script; reading its clock advances it."""

    def on_line(port_handler_class):
        class OnLine(port_handler_class):
            def setupPort(self, _):  # noqa: N802
                self.ser, self.is_open = line, True
                self.tx_time_per_byte = 0.01
                line.timeout = 0.0
                return True

            def getCurrentTime(self):  # noqa: N802
                line.clock.s += 0.0005
                return line.clock.s * 1000

        port = OnLine("scripted")
        port.openPort()
        return port

    return on_line


@pytest.fixture
def pty_name():
    """Yield the name of a pseudo-terminal without a device at its other end."""
    pty = pytest.importorskip("pty", reason="pseudo-terminals are a Unix thing")
    master, slave = pty.openpty()
    yield os.ttyname(slave)
    os.close(slave)
    os.close(master)


@pytest.fixture
def simulated():
    """Yield a function that opens simulated arms by name, as ``--port sim`` does."""
    buses = []

    def open_simulated(arm, query="", baud_rate=1_000_000, retries=2):
        path = Path(__file__).parents[2] / "configs" / arm / "arm.toml"
        if PortMode.name == "echo" and not query:
            query = "?echo=1"
        port = open_port(f"sim:{path}{query}", baud_rate)
        buses.append(ServoBus(port, list(read_servo_specs(path)), retries=retries))
        return buses[-1], port.transport.line.servos

    yield open_simulated
    for bus in buses:
        bus.close()


def read_servo_specs(path):
    """Yield the specification of every servo in an arm file, shadows included."""
    for joint in tomllib.loads(path.read_text())["joints"]:
        for servo in [joint["servo"], *joint.get("shadows", [])]:
            name = joint["name"] if servo is joint["servo"] else f"{joint['name']} shadow"
            yield ServoSpec(servo["id"], control_table(servo["model"]), name)
