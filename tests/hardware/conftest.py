"""A line on which every byte is written down beforehand."""

from __future__ import annotations

import os
import tomllib
from collections import deque
from pathlib import Path

import pytest

from ikservo.hardware import Port, ServoBus, ServoSpec, open_port
from ikservo.hardware.pending import AdaptiveTimeout, LineHealth
from ikservo.registers import STS3215, XL430W250, control_table

from .desk import Mode

_BYTE_FOR_BYTE = {"line", "stock_port"}  # what is written down there is said on a plain line


def pytest_configure(config):
    Mode.name = config.getoption("--line")


def pytest_collection_modifyitems(items):
    for item in items:
        if Mode.name != "plain" and _BYTE_FOR_BYTE.intersection(getattr(item, "fixturenames", ())):
            item.add_marker(pytest.mark.skip(reason="every byte is written down"))


@pytest.fixture
def plain_line():
    """Skip a test on how quick a line is, where lines are made bad."""
    if Mode.name != "plain":
        pytest.skip("about a plain line")


class StillClock:
    """Time that passes only when somebody waits."""

    def __init__(self):
        self.s = 0.0

    def now_s(self):
        return self.s

    def sleep_until(self, deadline_s):
        self.s = max(self.s, deadline_s)


class ScriptedLine:
    """Shaped like pyserial's Serial: asserts what is sent, answers what the script says."""

    is_open = True

    def __init__(self):
        self.clock = StillClock()
        self.baudrate, self.timeout = 1_000_000, 0.0
        self.script = deque()  # (bytes that must be sent, [(delay in s, bytes that come back)])
        self.arriving = []  # (when, bytes)
        self.sent = []
        self.reads = 0

    def expect(self, sent, *answers, after_s=0.0005):
        """Say that these bytes must be sent next, and what comes back, in hex."""
        self.script.append((bytes.fromhex(sent), [(after_s, bytes.fromhex(a)) for a in answers]))
        return self

    def lay(self, stale, at_s=0.0):
        """Put bytes into the input that nobody asked for, now or later."""
        self.arriving.append((at_s, bytes.fromhex(stale)))

    def write(self, data):
        data = bytes(data)
        assert self.script, f"nothing should be sent, but {data.hex(' ')} was"
        expected, answers = self.script.popleft()
        assert data.hex(" ") == expected.hex(" ")
        self.sent.append(data)
        self.arriving += [(self.clock.s + delay_s, answer) for delay_s, answer in answers]
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
    """Give a scripted line; the whole script must have been spoken in the end."""
    line = ScriptedLine()
    yield line
    assert not line.script, f"never sent: {[sent.hex(' ') for sent, _ in line.script]}"


@pytest.fixture
def port(line):
    """Give our port on the scripted line, which it has come to believe and to know as quick."""
    port = Port(line, "scripted", 1_000_000)
    port.health, port.reply_timeout = LineHealth(clean_requests=0), AdaptiveTimeout(0.001, 0.001)
    return port


@pytest.fixture
def feetech(port):
    """Give a bus with two STS3215 that never asks twice."""
    names = {1: "shoulder_pan", 2: "shoulder_lift"}
    return ServoBus(port, [ServoSpec(i, STS3215, name) for i, name in names.items()], retries=0)


@pytest.fixture
def dynamixel(port):
    """Give a bus with two XL430 that never asks twice."""
    names = {1: "waist", 2: "shoulder"}
    return ServoBus(
        port, [ServoSpec(i, XL430W250, name) for i, name in names.items()], retries=0, fast=False
    )


@pytest.fixture
def stock_port(line):
    """Put a vendor's own port handler on the scripted line; its clock ticks when it looks."""

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
    """Give the name of a pseudo-terminal at whose other end nobody speaks."""
    pty = pytest.importorskip("pty", reason="pseudo-terminals are a Unix thing")
    master, slave = pty.openpty()
    yield os.ttyname(slave)
    os.close(slave)
    os.close(master)


@pytest.fixture
def simulated():
    """Open simulated arms by name, as a person would with ``--port sim``; time is virtual."""
    buses = []

    def open_simulated(arm, query="", baud_rate=1_000_000, retries=2):
        path = Path(__file__).parents[2] / "configs" / arm / "arm.toml"
        if Mode.name == "echo" and not query:
            query = "?echo=1"
        port = open_port(f"sim:{path}{query}", baud_rate)
        buses.append(ServoBus(port, list(servos_of(path)), retries=retries))
        return buses[-1], port.transport.line.servos

    yield open_simulated
    for bus in buses:
        bus.close()


def servos_of(path):
    """Yield every servo that an arm file names, shadows included."""
    for joint in tomllib.loads(path.read_text())["joints"]:
        for servo in [joint["servo"], *joint.get("shadows", [])]:
            name = joint["name"] if servo is joint["servo"] else f"{joint['name']} shadow"
            yield ServoSpec(servo["id"], control_table(servo["model"]), name)
