"""How often goals can be streamed: what one turn of the bus takes, with room to spare."""

from __future__ import annotations

from statistics import median

from ikservo.arm.streaming.feedback import Feedback
from ikservo.hardware.bus import ServoBus

__all__ = ["measure_cycle_time_s"]

_BEATS_S = (0.002, 0.0025, 0.004, 0.005, 0.008, 0.01)
_READINGS = 5
# The bus is busy for a quarter of each beat; the rest is for us, for repeats and for others.
_ROOM = 4.0
_LEAST_ROOM = 1.25  # a slow bus may be busy for most of it


def measure_cycle_time_s(bus: ServoBus, feedback: Feedback) -> float:
    """Read the positions a few times and choose the control cycle that the bus allows.

    Returns:
        The time between two goals: 500 to 100 Hz, less on a slow bus.

    Raises:
        BusError: A servo does not answer.
    """
    cycle_s = _reading_s(bus, feedback) + _telling_s(bus)
    for beat_s in _BEATS_S:
        if beat_s >= _ROOM * cycle_s:
            return beat_s
    return max(_BEATS_S[-1], _LEAST_ROOM * cycle_s)


def _reading_s(bus: ServoBus, feedback: Feedback) -> float:
    """Return how long it takes to read all positions, and what one servo says besides."""
    taken_s: list[float] = []
    for _ in range(_READINGS):
        begin_s = bus.clock.now_s()
        feedback.measure()
        taken_s.append(bus.clock.now_s() - begin_s)
    return median(taken_s) * (1.0 + 1.0 / len(bus.servos))


def _telling_s(bus: ServoBus) -> float:
    """Return how long the goals of all servos are on the wire; nobody answers to them."""
    header = 14
    each = 1 + next(iter(bus.servos.values())).table.goal_position.size
    return bus.port.wire_s(header + each * len(bus.servos))
