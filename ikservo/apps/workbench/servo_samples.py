"""Take samples of servo registers for plots."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from ikservo.clock import Rate
from ikservo.hardware.bus import ServoBus
from ikservo.registers import ControlTable, Register, RegisterName

_LIVE = (
    RegisterName.GOAL_POSITION,
    RegisterName.PRESENT_POSITION,
    RegisterName.PRESENT_VELOCITY,
    RegisterName.PRESENT_LOAD,
    RegisterName.PRESENT_VOLTAGE,
    RegisterName.PRESENT_TEMPERATURE,
)
_SHORTEST_S, _ROUNDING = 1e-4, 1e-6  # shortest period; rounding, relative to a period
_CURRENT = "present_current"  # shown with the load if a model measures both


@dataclass(frozen=True, slots=True)
class Sample:
    """Registers of servos at one time.

    Attributes:
        time_s: Time since the first sample.
        values: The values by id and register, in the register's unit, without servos that did not
            reply.
    """

    time_s: float
    values: Mapping[int, Mapping[Register, float]]


def live_registers(table: type[ControlTable]) -> list[Register]:
    """Return the registers of a model for motion, load, voltage and temperature."""
    found = {table.find(name): None for name in _LIVE}
    if _CURRENT in table.registers:
        found[table.registers[_CURRENT]] = None
    return list(found)


def sample_registers(
    bus: ServoBus,
    watched: Mapping[int, Sequence[Register]],
    period_s: float,
    duration_s: float = math.inf,
) -> Iterator[Sample]:
    """Read registers of servos periodically.

    If the period is too short, samples are taken as fast as the line allows.

    Raises:
        BusError: A servo did not reply to the first read; later it is left out of a sample.
        PortLostError: The port is lost.
    """
    bus.bulk_read(watched).require_all()
    period_s = max(period_s, _SHORTEST_S)
    for time_s in Rate(bus.clock, period_s):
        yield Sample(time_s, bus.bulk_read(watched).values)
        if (round(time_s / period_s) + 1 - _ROUNDING) * period_s > duration_s:
            return
