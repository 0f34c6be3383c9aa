"""Ticks become radians: one servo's place in one joint, exact in both directions."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from ikservo.calibration.ticks.crank import Crank
from ikservo.calibration.ticks.words import JointUnit, say
from ikservo.errors import BadValueError

__all__ = ["JointMap"]


@dataclass(frozen=True, slots=True)
class JointMap:
    """How the ticks that a servo reports relate to the joint it turns.

    ``position = sign * (tick - zero_tick) * unit_per_tick``; where a crank stands between, that
    is the angle of the horn, and the crank makes the slide's position of it.

    Attributes:
        joint: Name of the joint.
        servo_id: Id of the servo on the bus.
        sign: +1 where growing ticks are a growing joint position, else -1.
        zero_tick: The tick at position zero; may lie between two ticks.
        unit_per_tick: Radians (metres for a prismatic joint) a tick, positive; with a crank the
            most that a tick is worth.
        unit: What a position is measured in.
        crank: Between the horn and the joint, if any.
        horn_rad_per_tick: A tick as a part of the horn's own turn.
    """

    joint: str
    servo_id: int
    sign: int
    zero_tick: float
    unit_per_tick: float
    unit: JointUnit = "rad"
    crank: Crank | None = None
    horn_rad_per_tick: float = math.tau / 4096

    @classmethod
    def revolute(
        cls,
        joint: str,
        servo_id: int,
        sign: int,
        zero_tick: float,
        ticks_per_turn: float,
        gear: float = 1.0,
    ) -> JointMap:
        """Return the map of a joint that its servo's horn turns, ``gear`` turns for one of it."""
        horn = math.tau / ticks_per_turn
        return cls(joint, servo_id, sign, zero_tick, horn / gear, horn_rad_per_tick=horn)

    @classmethod
    def prismatic(
        cls,
        joint: str,
        servo_id: int,
        sign: int,
        zero_tick: float,
        ticks_per_turn: float,
        m_per_turn: float,
    ) -> JointMap:
        """Return the map of a slide that its servo's horn drives by a rack or pinion."""
        unit, horn = m_per_turn / ticks_per_turn, math.tau / ticks_per_turn
        return cls(joint, servo_id, sign, zero_tick, unit, "m", horn_rad_per_tick=horn)

    @classmethod
    def cranked(
        cls,
        joint: str,
        servo_id: int,
        sign: int,
        zero_tick: float,
        ticks_per_turn: float,
        crank: Crank,
    ) -> JointMap:
        """Return the map of a slide that its servo's horn drives by a crank and a rod."""
        horn = math.tau / ticks_per_turn
        unit = crank.steepest_m_per_rad * horn
        return cls(joint, servo_id, sign, zero_tick, unit, "m", crank, horn)

    def placed(self, sign: int, zero_tick: float) -> JointMap:
        """Return the map of the same joint with its servo mounted another way."""
        return replace(self, sign=sign, zero_tick=zero_tick)

    @property
    def gear(self) -> float:
        """Return the horn's turns for one of a joint that turns; 1 for one that slides."""
        return self.horn_rad_per_tick / self.unit_per_tick if self.unit == "rad" else 1.0

    def position(self, tick: float) -> float:
        """Return the joint position [rad or m] at a tick."""
        if self.crank:
            return self.crank.position(self.sign * (tick - self.zero_tick) * self.horn_rad_per_tick)
        return self.sign * (tick - self.zero_tick) * self.unit_per_tick

    def furthest(self, tick: float) -> float:
        """Return the position [rad or m] on the way to a tick that may lie past a dead centre."""
        if self.crank:
            turned_rad = self.sign * (tick - self.zero_tick) * self.horn_rad_per_tick
            return self.crank.position(self.crank.until_dead_centre(turned_rad))
        return self.position(tick)

    def exact_tick(self, position: float) -> float:
        """Return the tick, with its fraction, at a joint position [rad or m]."""
        return self.zero_tick + self.ticks_from_zero(position)

    def ticks_from_zero(self, position: float) -> float:
        """Return how many ticks, signed, lie between position zero and a position [rad or m]."""
        if self.crank:
            return self.sign * self.crank.turned_rad(position) / self.horn_rad_per_tick
        return self.sign * position / self.unit_per_tick

    def tick(self, position: float) -> int:
        """Return the nearest whole tick to a joint position [rad or m].

        Raises:
            BadValueError: The position is not finite.
        """
        if not math.isfinite(position):
            raise BadValueError(f"The goal of {self.joint}", position, "a finite number")
        return math.floor(self.exact_tick(position) + 0.5)

    def say(self, position: float) -> str:
        """Return a position as a person reads it: ``101.3°`` or ``12.0 mm``."""
        return say(position, self.unit)

    def ticks_inside(self, lower: float, upper: float) -> tuple[int, int]:
        """Return the lowest and the highest tick whose positions lie in [lower, upper].

        Raises:
            BadValueError: No tick lies inside.
        """
        a, b = sorted((self.exact_tick(lower), self.exact_tick(upper)))
        # A limit that is itself a tick must not be lost to the last bit of a division.
        low, high = math.ceil(a - 1e-6), math.floor(b + 1e-6)
        if low > high:
            raise BadValueError(f"The range of {self.joint}", f"[{lower}, {upper}]", "a tick in it")
        return low, high
