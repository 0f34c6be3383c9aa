"""Press rotors against the driving flanks of their gears before a motion begins."""

from __future__ import annotations

import numpy as np

from ikservo.kinematics.arrays import Vector

_LEAD_RAD = 0.002  # at the horn, beyond friction; with 0.003 the rotor throws the link 0.3° ahead
_LEAD_RAD_S = 0.04  # rate of this lead, slow enough that the rotor does not throw the link
_TURN_S = 0.05  # time in which friction reverses, because goals must not jump
_MOVED_TICKS = 0.9  # a joint that has moved by this is already pushed by its rotor
_MAX_S = 0.2  # longest wait before a motion; 1° of backlash of an STS3215 takes 0.3 s


class Preload:
    """Lead of resting joints' goals until their rotors have crossed the backlash of the gears.

    Without preload, rotors cross the backlash at the beginning of the motion: arms with 1.7° of
    backlash started 7 mm off their lines, and swung.

    Args:
        sides: The direction in which each joint (n,) will move: -1 or 1; 0 for joints without
            preload.
        start: The joints at rest (n,), rad or m.
        per_horn_rad: Motion of each joint per radian of its horn (n,), rad or m.
        tick: Motion of each joint per tick (n,).

    Attributes:
        joints: The joints (n,) that are preloaded.
        lead: Lead of the goals (n,), rad or m, in addition to friction.
    """

    def __init__(self, sides: Vector, start: Vector, per_horn_rad: Vector, tick: Vector) -> None:
        self.joints = sides != 0.0
        self._start = start
        self.lead = np.zeros_like(sides)
        self._sides, self._per_horn_rad, self._tick = sides, per_horn_rad, tick
        self._for_s = 0.0

    def update(self, measured: Vector, direction: Vector, elapsed_s: float) -> Vector | None:
        """Advance one cycle; return the direction of friction (n,), None when preload is complete.

        Joints (n,) are in rad or m, directions (n,) of friction from -1 to 1.
        """
        self._for_s += elapsed_s
        moved = self._sides * (measured - self._start)
        waits = self.joints & (moved < _MOVED_TICKS * self._tick)
        if self._for_s >= _MAX_S or not waits.any():
            return None
        most = _LEAD_RAD_S * elapsed_s * self._per_horn_rad
        goal = np.where(waits, _LEAD_RAD * self._sides * self._per_horn_rad, 0.0)
        self.lead = self.lead + np.clip(goal - self.lead, -most, most)
        turn = 2.0 * elapsed_s / _TURN_S
        return direction + np.where(waits, np.clip(self._sides - direction, -turn, turn), 0.0)
