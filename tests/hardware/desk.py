"""Simulated servos on a desk, of whatever models a test needs, on one line."""

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


MODES = ("echo", "bytes", "rubbish")
"""An adapter that hears itself; bytes that come one at a time; three that mean nothing before
each answer. ``pytest tests/hardware --line MODE`` puts every simulated line there."""


class Mode:
    """How lines are heard in this run."""

    name = "plain"


def line_with(models, baud=BAUD, seed=0):
    """Return a simulated transport to servos given as {id: model}, or as pairs."""
    pairs = models.items() if isinstance(models, dict) else models
    world = make_bench_world([BenchServo(i, model) for i, model in pairs], baud, seed)
    line = Line(world, baud, LineOptions(seed=seed))
    if Mode.name == "echo":
        line.adapter = UsbAdapter(line.inbox, ECHO)
    if Mode.name == "rubbish":
        line.faults.add(Fault("garbage", bytes=3))
    return _Host(line)


class _Host(SimulatedPort):
    """No host asks the next question in the very moment in which the last answer ends."""

    def write(self, data):
        self.clock.sleep_until(self.clock.now_s() + 2e-6)
        return super().write(data)

    def read(self, size=1):
        return super().read(min(size, 1) if Mode.name == "bytes" else size)


def bus_with(models, baud=BAUD, seed=0, retries=2, adapter=None):
    """Return a bus with servos given as {id: model}; its port's transport is the simulated one."""
    transport = line_with(models, baud, seed)
    if adapter is not None:
        transport.line.adapter = UsbAdapter(transport.line.inbox, adapter)
    servos = [ServoSpec(i, control_table(model), f"joint_{i}") for i, model in models.items()]
    return ServoBus(Port(transport, "desk", baud), servos, retries=retries)


def spoil(bus, *faults):
    """Let faults happen on a simulated bus, each (kind, its attributes)."""
    for kind, attributes in faults:
        bus.port.transport.line.faults.add(Fault(kind, **attributes))


def simulated_servos(bus):
    """Return the simulated servos by id: the witnesses."""
    return bus.port.transport.line.servos
