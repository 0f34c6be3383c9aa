"""The quantity of one count of a register, in SI units."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians, tau


@dataclass(frozen=True, slots=True)
class Unit:
    """A scale from a register's integer to a quantity.

    Attributes:
        symbol: The unit of the quantity; empty for a plain number.
        step: The quantity of one count, or ``None`` for a plain number.
    """

    symbol: str
    step: float | None

    def to_value(self, raw: int) -> float:
        """Convert a count to the quantity; a plain number stays an integer."""
        return raw if self.step is None else raw * self.step

    def to_raw(self, value: float) -> int:
        """Convert a quantity to the nearest count."""
        return round(value if self.step is None else value / self.step)


RPM = tau / 60  # rad/s
"""One revolution per minute in rad/s."""

# fmt: off
NUMBER       = Unit("",       None)           # a code, a gain, a set of bits
TICK_4096    = Unit("rad",    tau / 4096)     # 12-bit encoder
TICK_300     = Unit("rad",    radians(300) / 1024)  # 10-bit potentiometer, by its travel
TICK_200     = Unit("rad",    radians(200) / 1024)
TICK_RATE    = Unit("rad/s",  tau / 4096)     # ticks per second
TICK_RATE_50 = Unit("rad/s",  50 * tau / 4096)
TICK_RATE_300 = Unit("rad/s", radians(300) / 1024)
TICK_RATE_200 = Unit("rad/s", radians(200) / 1024)
TICK_ACCEL   = Unit("rad/s²", 100 * tau / 4096)
DECI_VOLT    = Unit("V",      0.1)
CELSIUS      = Unit("°C",     1.0)
PER_MILLE    = Unit("1",      0.001)  # fraction of the maximum
PER_1023     = Unit("1",      1 / 1023)
PERCENT      = Unit("1",      0.01)
US_2         = Unit("s",      2e-6)
MS_1         = Unit("s",      1e-3)
MS_10        = Unit("s",      10e-3)
MS_20        = Unit("s",      20e-3)
MA_1         = Unit("A",      1e-3)
MA_2_69      = Unit("A",      2.69e-3)
MA_6_5       = Unit("A",      6.5e-3)
PWM_885      = Unit("1",      1 / 885)        # 885 counts are the full supply voltage
RPM_0_111    = Unit("rad/s",  0.111 * RPM)
RPM_0_114    = Unit("rad/s",  0.114 * RPM)
RPM_0_229    = Unit("rad/s",  0.229 * RPM)
RPM2_214_577 = Unit("rad/s²", 214.577 * tau / 3600)  # 214.577 revolutions per minute squared
DEG_S2_8_583 = Unit("rad/s²", radians(8.583))
MV_PER_MS    = Unit("V/s",    1.977)
MV_PER_MS_12 = Unit("V/s",    3.955)          # 12 V servos
# fmt: on
