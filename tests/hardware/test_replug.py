"""A pulled cable raises a named error at once; the adapter is found under another name."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass

import pytest

from ikservo.errors import PortLostError
from ikservo.hardware import Port, ServoBus, ServoSpec, open_port, reconnect, serial_number_of
from ikservo.registers import STS3215

from .conftest import ManualClock
from .factories import make_transport

pty = pytest.importorskip("pty", reason="pseudo-terminals are a Unix thing")


@dataclass
class Comport:
    """A port as pyserial describes it."""

    device: str
    serial_number: str | None = "58FA083"
    vid: int | None = 0x1A86
    pid: int | None = 0x55D3
    product: str | None = "USB Single Serial"


@pytest.fixture
def set_adapters(monkeypatch):
    """Return a function that sets the adapters that are plugged in."""

    def plug_in(*comports):
        monkeypatch.setattr("serial.tools.list_ports.comports", lambda: list(comports))

    return plug_in


@pytest.fixture
def new_pty():
    """Create pseudo-terminals, and close them at the end."""
    ends = []

    def make():
        ends.extend(pty.openpty())
        return os.ttyname(ends[-1]), ends[-2:]

    yield make
    for end in ends:
        try:
            os.close(end)
        except OSError:
            continue


def test_adapter_is_identified_by_serial_number(set_adapters):
    set_adapters(Comport("/dev/ttyACM0"))
    assert serial_number_of("/dev/ttyACM0") == "58FA083"


def test_network_port_has_no_serial_number(set_adapters):
    set_adapters(Comport("/dev/ttyACM0"))
    assert serial_number_of("socket://127.0.0.1:1") == ""


def test_reconnect_finds_adapter_under_its_new_name(set_adapters, new_pty):
    (old, ends), (new, _) = new_pty(), new_pty()
    port = open_port(old, 1_000_000)
    for end in ends:
        os.close(end)
    set_adapters(Comport("/dev/ttyUSB7", "another"), Comport(new))
    reconnect(port, "58FA083", within_s=1.0, clock=ManualClock())
    assert (port.name, port.is_open) == (new, True)
    port.close()


def test_reconnect_resets_echo_and_line_health_of_old_port(set_adapters, new_pty):
    (old, _), (new, _) = new_pty(), new_pty()
    port = open_port(old, 1_000_000)
    port.echoes, health = True, port.health
    set_adapters(Comport(new))
    reconnect(port, "58FA083", within_s=1.0, clock=ManualClock())
    assert port.echoes is None
    assert port.health is not health
    port.close()


def test_bus_reconnects_to_adapter_under_its_new_name(set_adapters, new_pty):
    (old, _), (new, _) = new_pty(), new_pty()
    with ServoBus(open_port(old, 1_000_000), [ServoSpec(1, STS3215)]) as bus:
        set_adapters(Comport(new))
        bus.reconnect("58FA083", within_s=1.0)
        assert (bus.port.name, bus.port.is_open) == (new, True)


def test_reconnect_ignores_adapter_with_another_serial_number(set_adapters, new_pty):
    (old, _), (other, _) = new_pty(), new_pty()
    port = open_port(old, 1_000_000)
    set_adapters(Comport(other, "another"))
    with pytest.raises(PortLostError, match="not reconnected within 3 s"):
        reconnect(port, "58FA083", within_s=3.0, clock=ManualClock())
    assert not port.is_open


def test_adapter_without_serial_number_reconnects_by_old_name(set_adapters, new_pty):
    old, _ = new_pty()
    port = open_port(old, 1_000_000)
    set_adapters(Comport(old, serial_number=None))
    reconnect(port, "", within_s=1.0, clock=ManualClock())
    assert port.is_open
    port.close()


@pytest.mark.parametrize("moment", range(20))
def test_unplugged_cable_raises_error_before_read_deadline(new_pty, moment):
    name, (master, slave) = new_pty()
    port = open_port(name, 1_000_000)
    os.close(slave)
    if moment % 2:
        os.write(master, bytes(moment))
    os.close(master)
    started_s, cpu_s = time.monotonic(), time.process_time()
    with pytest.raises(PortLostError):
        port.read_until(100, started_s + 5.0)
    assert time.monotonic() - started_s < 2.5
    assert time.process_time() - cpu_s < 0.5
    port.close()


def test_port_connect_resets_learned_time_outs_and_echo():
    port = Port(make_transport({1: "STS3215"}), "old", 1_000_000)
    new = Port(make_transport({1: "STS3215"}), "new", 57_600)
    lock, kept = port.lock, vars(port).keys()
    port.is_using, port.echoes = True, True
    old = {name: vars(port)[name] for name in ("byte_rate", "health", "pending", "reply_timeout")}
    port.connect(new.transport, "new", 57_600)
    assert (port.name, port.baudrate, port.transport) == ("new", 57_600, new.transport)
    assert (port.is_using, port.echoes, port.sent) == (False, None, b"")
    assert all(vars(port)[name] is not value for name, value in old.items())
    assert port.lock is lock
    assert vars(port).keys() == kept == vars(new).keys()
