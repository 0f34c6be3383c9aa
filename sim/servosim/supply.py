"""The power supply of a bus of servos: its voltage sags with the current they draw."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from servosim.motor import Motor


@dataclass(slots=True)
class Supply:
    """A supply behind a resistance (its own, the cable's and the connectors').

    Attributes:
        open_v: Voltage without load.
        resistance_ohm: From the source to the servos.
        standby_a: Electronics of all servos together.
    """

    open_v: float
    resistance_ohm: float = 0.1
    standby_a: float = 0.0

    def voltage_v(self, motors: Iterable[Motor]) -> float:
        """Voltage at the servos' plugs.

        A bridge draws the winding's current for the share of time that its duty says; a motor
        that brakes feeds none back (the servos have no such path).
        """
        drawn_a = self.standby_a + sum(max(0.0, m.current_a * m.pwm) for m in motors)
        return max(0.0, self.open_v - self.resistance_ohm * drawn_a)
