"""Map between encoder ticks and joint positions, exact in both directions."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

from ikservo.errors import BadValueError
from ikservo.registers import ControlTable

__all__ = [
    "Crank",
    "Encoder",
    "JointMap",
    "JointUnit",
    "encoder_of",
    "format_position",
    "source_words",
    "unwrap",
    "unwrap_near",
    "wrapped_difference",
]


@dataclass(frozen=True, slots=True)
class Crank:
    """A crank of radius r turns by φ and pushes a slide through a rod of length l.

    ``x(φ) = r cos φ + sqrt(l² - r² sin² φ)``, which falls from r + l at φ = 0 to l - r at
    φ = π and has one inverse in between: ``cos φ = (x² + r² - l²) / (2 r x)``.

    Attributes:
        radius_m: From the horn's axis to the pin.
        rod_m: From the pin to the slide; longer than the radius.
        zero_rad: φ at the joint's position zero, between 0 and π.
    """

    radius_m: float
    rod_m: float
    zero_rad: float

    def __post_init__(self) -> None:
        if not 0.0 < self.radius_m < self.rod_m:
            raise BadValueError("The crank's radius", self.radius_m, "more than 0, less than rod_m")
        if not 0.0 < self.zero_rad < math.pi:
            raise BadValueError("The crank's zero", self.zero_rad, "between 0 and pi")

    def position(self, turned_rad: float) -> float:
        """Return the slide's position [m] after the horn has turned that far from zero."""
        return self._slide_reach(self.zero_rad - turned_rad) - self._slide_reach(self.zero_rad)

    def turned_rad(self, position: float) -> float:
        """Return how far the horn has turned from zero [rad] at a position [m]."""
        x, r, rod = position + self._slide_reach(self.zero_rad), self.radius_m, self.rod_m
        cosine = (x * x + r * r - rod * rod) / (2.0 * r * x)
        return self.zero_rad - math.acos(min(1.0, max(-1.0, cosine)))

    def clamp_to_dead_centre(self, turned_rad: float) -> float:
        """Return a turn of the horn from zero, cut where the slide would begin to come back."""
        return min(self.zero_rad, max(self.zero_rad - math.pi, turned_rad))

    @property
    def max_m_per_rad(self) -> float:
        """Return the most that the slide moves for a small turn of the horn."""
        angles = (math.pi * k / 180.0 for k in range(181))
        return max(-self._slide_slope(angle) for angle in angles)

    def _slide_reach(self, angle: float) -> float:
        across = self.radius_m * math.sin(angle)
        return self.radius_m * math.cos(angle) + math.sqrt(self.rod_m**2 - across**2)

    def _slide_slope(self, angle: float) -> float:
        across, along = self.radius_m * math.sin(angle), self.radius_m * math.cos(angle)
        return -across - across * along / math.sqrt(self.rod_m**2 - across**2)


JointUnit = Literal["rad", "m"]


def format_position(position: float, unit: JointUnit, digits: int = 1) -> str:
    """Return ``101.3°`` for a position in rad, ``12.0 mm`` for one in m."""
    if unit == "m":
        return f"{position * 1000:z.{digits}f} mm"
    return f"{math.degrees(position):z.{digits}f}°"


def source_words(source: str) -> str:
    """Return the source of a limit for a sentence: ``user`` becomes ``set by you``."""
    return " / ".join("set by you" if part == "user" else part for part in source.split(" / "))


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
        unit = crank.max_m_per_rad * horn
        return cls(joint, servo_id, sign, zero_tick, unit, "m", crank, horn)

    def with_mounting(self, sign: int, zero_tick: float) -> JointMap:
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

    def position_clamped(self, tick: float) -> float:
        """Return the position [rad or m] on the way to a tick that may lie past a dead centre."""
        if self.crank:
            turned_rad = self.sign * (tick - self.zero_tick) * self.horn_rad_per_tick
            return self.crank.position(self.crank.clamp_to_dead_centre(turned_rad))
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

    def format(self, position: float) -> str:
        """Return a position as a person reads it: ``101.3°`` or ``12.0 mm``."""
        return format_position(position, self.unit)

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


_MAGNET = 4096  # Dynamixel X and MX, STS: a whole turn
_POTENTIOMETER = 1024  # AX and SCS: 300° of a turn (200° on the SCS15)


@dataclass(frozen=True, slots=True)
class Encoder:
    """A position sensor.

    Attributes:
        ticks: How many it tells apart; they are numbered from 0.
        ticks_per_turn: What a whole turn of the horn would be.
    """

    ticks: int
    ticks_per_turn: float

    @property
    def wraps(self) -> bool:
        """Return whether the count starts again after a turn, so that it has a seam."""
        return self.ticks == self.ticks_per_turn


def encoder_of(table: type[ControlTable]) -> Encoder:
    """Return the position sensor of a servo model."""
    whole = table.ticks_per_turn == _MAGNET
    return Encoder(_MAGNET if whole else _POTENTIOMETER, table.ticks_per_turn)


def wrapped_difference(start: int, end: int, turn: int) -> int:
    """Return the shorter signed way from one tick to another around a circle of ``turn``.

    Half a turn counts as backwards: the result lies in [-turn/2, turn/2).
    """
    return (end - start + turn // 2) % turn - turn // 2


def unwrap(last: int, reading: int, turn: int) -> int:
    """Return a reading counted on from the last unwrapped one, over any number of turns."""
    return last + wrapped_difference(last, reading, turn)


def unwrap_near(middle: int, reading: int, turn: int) -> int:
    """Return the reading moved by whole turns to within half a turn of ``middle``."""
    return unwrap(middle, reading, turn)
