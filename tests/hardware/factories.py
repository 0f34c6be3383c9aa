"""Simulated servos of any models on one bus."""

from __future__ import annotations

from ikservo.hardware import Port, ServoBus, ServoSpec
from ikservo.registers import control_table
from servosim.adapter import AdapterOptions, UsbAdapter
from servosim.assembly import BenchServo, make_bench_world
from servosim.faults import Fault
from servosim.line import Line, LineOptions
from servosim.port import SimulatedPort

BAUD = 1_000_000
PLAIN, ECHO = AdapterOptions(), AdapterOptions(echo=True)
USB_FRAMES = AdapterOptions(usb_frame_s=0.001)
FTDI = AdapterOptions(usb_frame_s=0.001, latency_s=0.001)


MODES = ("echo", "bytes", "garbage")
"""An adapter that echoes; bytes that arrive one at a time; three garbage bytes before each reply.
``pytest tests/hardware --line MODE`` applies one of them to every simulated bus."""


class PortMode:
    """The mode of the simulated buses in this run."""

    name = "plain"


def make_transport(models, baud=BAUD, seed=0):
    """Return a simulated transport to servos given as {id: model}, or as pairs."""
    pairs = models.items() if isinstance(models, dict) else models
    world = make_bench_world([BenchServo(i, model) for i, model in pairs], baud, seed)
    line = Line(world, baud, LineOptions(seed=seed))
    if PortMode.name == "echo":
        line.adapter = UsbAdapter(line.inbox, ECHO)
    if PortMode.name == "garbage":
        line.faults.add(Fault("garbage", bytes=3))
    return _Host(line)


class _Host(SimulatedPort):
    """A host that sends each request a moment after the previous reply has ended."""

    def write(self, data):
        self.clock.sleep_until(self.clock.now_s() + 2e-6)
        return super().write(data)

    def read(self, size=1):
        return super().read(min(size, 1) if PortMode.name == "bytes" else size)


def make_bus(models, baud=BAUD, seed=0, retries=2, adapter=None):
    """Return a bus with servos given as {id: model}; its port's transport is the simulated one."""
    transport = make_transport(models, baud, seed)
    if adapter is not None:
        transport.line.adapter = UsbAdapter(transport.line.inbox, adapter)
    servos = [ServoSpec(i, control_table(model), f"joint_{i}") for i, model in models.items()]
    return ServoBus(Port(transport, "bench", baud), servos, retries=retries)


def add_faults(bus, *faults):
    """Add faults to a simulated bus, each (kind, its attributes)."""
    for kind, attributes in faults:
        bus.port.transport.line.faults.add(Fault(kind, **attributes))


def simulated_servos(bus):
    """Return the simulated servos by id."""
    return bus.port.transport.line.servos
