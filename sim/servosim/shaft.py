"""Between a joint's radians and the ticks of the sensor on the servo's output shaft."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

__all__ = ["Shaft"]


@dataclass(slots=True)
class Shaft:
    """How a servo is mounted: hidden truth that no register tells.

    Attributes:
        sign: +1 or -1, direction of growing ticks in the joint's coordinate.
        zero_tick: Tick of the sensor at joint zero; may be fractional.
        ticks: Ticks of one turn of the servo's shaft.
        rad_per_tick: Radians of one tick.
    """

    sign: int = 1
    zero_tick: float = 2048.0
    ticks: float = 4096
    rad_per_tick: float = field(init=False)

    def __post_init__(self) -> None:
        self.rad_per_tick = 2.0 * math.pi / self.ticks

    def tick_at(self, angle_rad: float) -> int:
        """Return the nearest tick, counted on over whole turns."""
        turns = angle_rad / (2.0 * math.pi)
        return round(self.zero_tick + self.sign * turns * self.ticks)

    def angle_at(self, tick: float) -> float:
        """Return the joint angle [rad] at a tick counted over whole turns."""
        return self.sign * (tick - self.zero_tick) * self.rad_per_tick
