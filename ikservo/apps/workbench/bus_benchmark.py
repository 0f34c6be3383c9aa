"""Measure the timing of the bus: reads and writes per second, host time, jitter.

The present profile velocity of each servo is written instead of a goal, because a goal would switch
on the torque of Feetech servos. It has as many bytes as a goal.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import cast

from ikservo.apps.workbench.line_quality import MeteredTransport, sorted_quantile
from ikservo.arm.opening import resolve_port, servo_specs
from ikservo.errors import BusError
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.duplicate_ids import raise_on_duplicate_ids
from ikservo.hardware.port import Port
from ikservo.hardware.transport import Transport, open_transport
from ikservo.model import Model
from ikservo.registers import Family, RegisterName

CYCLES = 1000
_WARM_UP = 50  # cycles until the adaptive time-out has settled

OnProgress = Callable[[str, int], None]

# fmt: off
POSITIONS = (RegisterName.PRESENT_POSITION,)
TELEMETRY = (RegisterName.PRESENT_POSITION,    RegisterName.PRESENT_VELOCITY,
             RegisterName.PRESENT_LOAD,        RegisterName.PRESENT_VOLTAGE,
             RegisterName.PRESENT_TEMPERATURE, RegisterName.ALARMS)
# fmt: on
_TASKS = {"positions + goals": POSITIONS, "full telemetry + goals": TELEMETRY}


@dataclass(frozen=True, slots=True)
class BusTiming:
    """Timing of cycles of one kind.

    Attributes:
        what: The kind of the cycles.
        cycles_s: Durations of the cycles, ascending, seconds.
        host_s: Median time of the host in a cycle, seconds.
        wire_s: Time that the bytes and return delays of one cycle take, seconds.
        sent_bytes: The bytes that one cycle sends.
        received_bytes: The bytes that one cycle receives.
        lost: Number of missing replies.
    """

    what: str
    cycles_s: tuple[float, ...]
    host_s: float
    wire_s: float
    sent_bytes: int
    received_bytes: int
    lost: int

    @property
    def rate_hz(self) -> float:
        """Return cycles per second."""
        return len(self.cycles_s) / sum(self.cycles_s)

    @property
    def limit_hz(self) -> float:
        """Cycles per second that the wire allows."""
        return 1.0 / self.wire_s

    def cycle_s(self, quantile: float) -> float:
        """Return a quantile of the cycles' durations, seconds."""
        return sorted_quantile(self.cycles_s, quantile)


def benchmark_bus(
    model: Model,
    port: str | None = None,
    cycles: int = CYCLES,
    on_cycle: OnProgress | None = None,
) -> list[BusTiming]:
    """Measure an arm's bus; nothing moves, and torque stays unchanged.

    On a simulated bus, time is virtual, and the host's own time is added to it. ``on_cycle`` gets
    the kind of cycle and the number of finished cycles.

    Raises:
        PortError: There is no port, or it is lost.
        ServoSilentError: Servos do not answer; the message names them.
        BadReplyError: Two servos share an id.
    """
    name = resolve_port(model, port)
    meter = MeteredTransport(open_transport(name, model.baud_rate))
    opened_port = Port(cast("Transport", meter), name, model.baud_rate)
    with ServoBus(opened_port, servo_specs(model)) as bus:
        try:
            bus.load_return_delays()
        except BusError:
            raise_on_duplicate_ids(bus)
            raise
        if bus.port.health.degraded:
            raise_on_duplicate_ids(bus)
        bench = _Benchmark(bus, meter, [joint.servo.id for joint in model.joints])
        return [
            bench.measure(what, names, cycles, on_cycle or (lambda _, __: None))
            for what, names in _TASKS.items()
        ]


class _Benchmark:
    def __init__(self, bus: ServoBus, meter: MeteredTransport, servo_ids: Sequence[int]) -> None:
        self._bus, self._meter, self._ids = bus, meter, servo_ids
        speeds = bus.sync_read(servo_ids, RegisterName.PROFILE_VELOCITY, raw=True).require_all()
        self._speeds: Mapping[int, int] = dict(speeds)
        self._virtual = hasattr(meter, "clock")
        self.lost = 0

    def measure(
        self, what: str, names: Sequence[RegisterName], cycles: int, on_progress: OnProgress
    ) -> BusTiming:
        for _ in range(_WARM_UP):
            self._run_cycle(names)
        sent, received = self._meter.sent, self._meter.received
        self._meter.capture, self._meter.captured = True, bytearray()
        self._run_cycle(names)
        self._meter.capture = False
        sent, received = self._meter.sent - sent, self._meter.received - received
        wire_s = self._bus.port.wire_s(sent + received)
        wire_s += self._delays_s(bytes(self._meter.captured))
        self.lost = 0
        took: list[tuple[float, float]] = []
        for count in range(1, cycles + 1):
            inside_s, busy_s = self._meter.inside_s, time.thread_time()
            bus_s = self._bus.clock.now_s()
            self._run_cycle(names)
            bus_s = self._bus.clock.now_s() - bus_s
            host_s = time.thread_time() - busy_s - (self._meter.inside_s - inside_s)
            took.append((bus_s + host_s if self._virtual else bus_s, host_s))
            on_progress(what, count)
        cycles_s = tuple(sorted(cycle_s for cycle_s, _ in took))
        median_s = sorted_quantile(sorted(host_s for _, host_s in took), 0.5)
        return BusTiming(what, cycles_s, median_s, wire_s, sent, received, self.lost)

    def _run_cycle(self, names: Sequence[RegisterName]) -> None:
        readings = self._bus.sync_read_many(self._ids, names, raw=True)
        self.lost += len(readings.errors)
        self._bus.sync_write(RegisterName.PROFILE_VELOCITY, self._speeds, raw=True)

    def _delays_s(self, received: bytes) -> float:
        """Compute the sum of the return delays of one cycle, one per received packet."""
        ids = [
            i
            for i in self._ids
            if RegisterName.RETURN_DELAY not in self._bus.servos[i].table.missing
        ]
        try:
            delays = self._bus.sync_read(ids, RegisterName.RETURN_DELAY).require_all()
        except BusError:
            return 0.0
        mean_s = sum(delays.values()) / max(1, len(delays))
        families = {self._bus.servos[i].table.family for i in self._ids}
        header = b"\xff\xff\xfd\x00" if families == {Family.DYNAMIXEL_2} else b"\xff\xff"
        return received.count(header) * mean_s
