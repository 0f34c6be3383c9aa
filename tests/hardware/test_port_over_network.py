"""Ports over a network: the same packets through a server in this process."""

from __future__ import annotations

import contextlib
import socket
import threading
import time

import pytest
from serial import rfc2217

from ikservo.errors import PortLostError
from ikservo.hardware import ServoBus, ServoSpec, open_port, torque_on
from ikservo.registers import STS3215, RegisterName

from .factories import make_transport

pytestmark = pytest.mark.usefixtures("plain_line")  # the server reads for itself


class SerialSide:
    """The settings of an RFC 2217 server: the baud rate is real, the others are only stored."""

    def __init__(self, transport):
        self.transport = transport
        self.bytesize, self.parity, self.stopbits, self.timeout = 8, "N", 1, 0
        self.rtscts = self.xonxoff = self.dtr = self.rts = self.break_condition = False
        self.cts = self.dsr = self.ri = self.cd = False

    def __getattr__(self, name):
        return getattr(self.transport, name)

    @property
    def baudrate(self):
        return self.transport.baudrate

    @baudrate.setter
    def baudrate(self, rate):
        self.transport.baudrate = rate


class Server:
    """Simulated servos behind a TCP port, raw or by RFC 2217."""

    def __init__(self, *, telnet):
        self.transport = make_transport({1: "STS3215", 2: "STS3215"})
        self.listening = socket.create_server(("127.0.0.1", 0))
        self.telnet, self.client, self.pending = telnet, None, b""
        self.thread = threading.Thread(target=self.serve)
        self.thread.start()

    @property
    def address(self):
        return f"127.0.0.1:{self.listening.getsockname()[1]}"

    def serve(self):
        with contextlib.suppress(OSError):
            self.client, _ = self.listening.accept()
            manager = rfc2217.PortManager(SerialSide(self.transport), self) if self.telnet else None
            while data := self.client.recv(4096):
                self.pass_on(b"".join(manager.filter(data)) if manager else data, manager)

    def pass_on(self, data, manager):
        """Pass whole packets to the servos: a network may split and join them."""
        self.pending += data
        while len(self.pending) > 3 and len(self.pending) >= self.pending[3] + 4:
            size = self.pending[3] + 4
            asked, self.pending = self.pending[:size], self.pending[size:]
            self.transport.write(asked)
            self.transport.timeout = 0.003  # virtual: the simulated servos answer at once
            answer = self.transport.read(4096)
            self.write(b"".join(manager.escape(answer)) if manager else answer)

    def write(self, data):
        self.client.sendall(data)

    def close(self):
        for end in filter(None, (self.client, self.listening)):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()
        self.thread.join(timeout=10)


@pytest.fixture(params=["socket", "rfc2217"])
def served(request):
    """Return the URL of a server and the server itself."""
    server = Server(telnet=request.param == "rfc2217")
    yield f"{request.param}://{server.address}", server
    server.close()


@pytest.fixture
def bus(served):
    """Return a bus on the server."""
    url, _ = served
    with ServoBus(open_port(url, 1_000_000), [ServoSpec(i, STS3215) for i in (1, 2)]) as bus:
        yield bus


@pytest.mark.sample(1)
def test_remote_servos_answer_ping(bus):
    assert [bus.ping(i).model_number for i in (1, 2)] == [777, 777]


@pytest.mark.sample(1)
def test_remote_servos_are_read_and_written_together(bus):
    ticks = {i: torque_on(bus, i) for i in (1, 2)}
    bus.sync_write(RegisterName.GOAL_POSITION, ticks, raw=True)
    assert bus.sync_read([1, 2], RegisterName.GOAL_POSITION, raw=True).require_all() == ticks


@pytest.mark.sample(1)
def test_network_port_disables_nagle_delay(bus):
    goals = {i: torque_on(bus, i) for i in (1, 2)}
    begin_s = time.monotonic()
    for _ in range(60):  # with Nagle's algorithm, ten a second
        bus.sync_read([1, 2], RegisterName.PRESENT_POSITION, raw=True)
        bus.sync_write(RegisterName.GOAL_POSITION, goals, raw=True)
    assert time.monotonic() - begin_s < 5.0


@pytest.mark.sample(1)
def test_server_shutdown_raises_port_lost_error(bus, served):
    bus.ping(1)
    served[1].close()
    with pytest.raises(PortLostError, match="Lost connection"):
        bus.read(1, RegisterName.PRESENT_POSITION)


def test_baud_rate_is_set_at_remote_end():
    server = Server(telnet=True)
    try:
        with open_port(f"rfc2217://{server.address}", 1_000_000) as port:
            port.setBaudRate(500_000)
            assert server.transport.baudrate == 500_000
    finally:
        server.close()
