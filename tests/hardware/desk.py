"""Simulated servos on a desk, of whatever models a test needs, on one line."""

from __future__ import annotations

from ikservo.hardware import Port, ServoBus, ServoSpec
from ikservo.registers import table_for
from servosim.adapter import Adapter, AdapterOptions
from servosim.assembly import LooseServo, loose_world
from servosim.faults import Fault
from servosim.line import Line, LineOptions
from servosim.port import SimulatedPort

BAUD = 1_000_000


def line_with(models, baud=BAUD, seed=0):
    """Return a simulated transport to servos given as {id: model}, or as pairs."""
    pairs = models.items() if isinstance(models, dict) else models
    world = loose_world([LooseServo(i, model) for i, model in pairs], baud, seed)
    return _Host(Line(world, baud, LineOptions(seed=seed)))


class _Host(SimulatedPort):
    """No host asks the next question in the very moment in which the last answer ends."""

    def write(self, data):
        self.clock.sleep_until(self.clock.now_s() + 2e-6)
        return super().write(data)


def bus_with(models, baud=BAUD, seed=0, retries=2, adapter=None):
    """Return a bus with servos given as {id: model}; its port's transport is the simulated one."""
    transport = line_with(models, baud, seed)
    if adapter is not None:
        transport.line.adapter = Adapter(transport.line.inbox, adapter)
    servos = [ServoSpec(i, table_for(model), f"joint_{i}") for i, model in models.items()]
    return ServoBus(Port(transport, "desk", baud), servos, retries=retries)


def spoil(bus, *faults):
    """Let faults happen on a simulated bus, each (kind, its attributes)."""
    for kind, attributes in faults:
        bus.port.transport.line.faults.add(Fault(kind, **attributes))


def simulated_servos(bus):
    """Return the simulated servos by id: the witnesses."""
    return bus.port.transport.line.servos


PLAIN, ECHO = AdapterOptions(), AdapterOptions(echo=True)
USB_FRAMES = AdapterOptions(usb_frame_s=0.001)
FTDI = AdapterOptions(usb_frame_s=0.001, latency_s=0.001)
