"""The map between encoder ticks and joint positions, exact in both directions."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

from ikservo.errors import BadValueError
from ikservo.registers import ControlTable


@dataclass(frozen=True, slots=True)
class Crank:
    """Crank of radius r that rotates by φ and moves a slider through a rod of length l.

    ``x(φ) = r cos φ + sqrt(l² - r² sin² φ)``, which falls from r + l at φ = 0 to l - r at φ = π and
    is invertible in between: ``cos φ = (x² + r² - l²) / (2 r x)``.

    Attributes:
        radius_m: Distance from the horn's axis to the pin.
        rod_m: Distance from the pin to the slider; longer than the radius.
        zero_rad: φ at the joint's position zero, between 0 and π.
    """

    radius_m: float
    rod_m: float
    zero_rad: float

    def __post_init__(self) -> None:
        if not 0.0 < self.radius_m < self.rod_m:
            raise BadValueError("The crank's radius", self.radius_m, "more than 0, less than rod_m")
        if not 0.0 < self.zero_rad < math.pi:
            raise BadValueError("The crank's zero", self.zero_rad, "an angle between 0 and pi")

    def position(self, horn_rad: float) -> float:
        """Compute the slider's position [m] at a rotation of the horn from zero."""
        return self._slide_reach(self.zero_rad - horn_rad) - self._slide_reach(self.zero_rad)

    def horn_rad(self, position: float) -> float:
        """Compute the rotation of the horn from zero [rad] at a position [m]."""
        x, r, rod = position + self._slide_reach(self.zero_rad), self.radius_m, self.rod_m
        cosine = (x * x + r * r - rod * rod) / (2.0 * r * x)
        return self.zero_rad - math.acos(min(1.0, max(-1.0, cosine)))

    def clamp_to_dead_centre(self, horn_rad: float) -> float:
        """Clamp a horn rotation from zero [rad] to the dead centres, where the slider reverses."""
        return min(self.zero_rad, max(self.zero_rad - math.pi, horn_rad))

    @property
    def max_m_per_rad(self) -> float:
        """The maximum slider motion per radian of the horn, m/rad."""
        slopes: list[float] = []
        for angle in (math.pi * k / 180.0 for k in range(181)):
            offset, along = self.radius_m * math.sin(angle), self.radius_m * math.cos(angle)
            slopes.append(offset + offset * along / math.sqrt(self.rod_m**2 - offset**2))
        return max(slopes)

    def _slide_reach(self, angle: float) -> float:
        offset = self.radius_m * math.sin(angle)
        return self.radius_m * math.cos(angle) + math.sqrt(self.rod_m**2 - offset**2)


JointUnit = Literal["rad", "m"]


def format_position(position: float, unit: JointUnit, digits: int = 1) -> str:
    """Format a position: ``101.3°`` for rad, ``12.0 mm`` for m."""
    if unit == "m":
        return f"{position * 1000:z.{digits}f} mm"
    return f"{math.degrees(position):z.{digits}f}°"


def format_source(source: str) -> str:
    """Format the source of a limit for use in a sentence: ``user`` becomes ``set by you``."""
    return " / ".join("set by you" if part == "user" else part for part in source.split(" / "))


@dataclass(frozen=True, slots=True)
class JointMap:
    """Conversion between the ticks of a servo and the position of its joint.

    ``position = sign * (tick - zero_tick) * unit_per_tick``; with a crank, this gives the angle of
    the horn, which the crank converts to the slider's position.

    Attributes:
        joint: Name of the joint.
        servo_id: Id of the servo on the bus.
        sign: +1 if the joint position increases with the ticks, otherwise -1.
        zero_tick: The tick at position zero; may be fractional.
        unit_per_tick: Radians (metres for a prismatic joint) per tick, positive; with a crank, the
            maximum.
        unit: The unit of positions.
        crank: The crank between the horn and the joint, if any.
        horn_rad_per_tick: Rotation of the horn per tick.
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
        """Compute the map of a revolute joint; the horn makes ``gear`` turns per joint turn."""
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
        """Compute the map of a prismatic joint that is driven by a rack and pinion."""
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
        """Compute the map of a prismatic joint that is driven by a crank and a rod."""
        horn = math.tau / ticks_per_turn
        unit = crank.max_m_per_rad * horn
        return cls(joint, servo_id, sign, zero_tick, unit, "m", crank, horn)

    def with_mounting(self, sign: int, zero_tick: float) -> JointMap:
        """Return the map of the same joint with a different mounting of its servo."""
        return replace(self, sign=sign, zero_tick=zero_tick)

    @property
    def unit_per_horn_rad(self) -> float:
        """Travel [rad or m] per radian of the horn; with a crank, the maximum."""
        return self.unit_per_tick / self.horn_rad_per_tick

    @property
    def gear(self) -> float:
        """Turns of the horn per turn of a revolute joint; 1 for a prismatic joint."""
        return self.horn_rad_per_tick / self.unit_per_tick if self.unit == "rad" else 1.0

    def position(self, tick: float) -> float:
        """Compute the joint position [rad or m] at a tick."""
        if self.crank:
            return self.crank.position(self.sign * (tick - self.zero_tick) * self.horn_rad_per_tick)
        return self.sign * (tick - self.zero_tick) * self.unit_per_tick

    def position_clamped(self, tick: float) -> float:
        """Compute the position [rad or m] at a tick, clamped to the crank's dead centres."""
        if self.crank:
            horn_rad = self.sign * (tick - self.zero_tick) * self.horn_rad_per_tick
            return self.crank.position(self.crank.clamp_to_dead_centre(horn_rad))
        return self.position(tick)

    def exact_tick(self, position: float) -> float:
        """Compute the tick, with its fraction, at a joint position [rad or m]."""
        return self.zero_tick + self.ticks_from_zero(position)

    def ticks_from_zero(self, position: float) -> float:
        """Compute the signed number of ticks from position zero to a position [rad or m]."""
        if self.crank:
            return self.sign * self.crank.horn_rad(position) / self.horn_rad_per_tick
        return self.sign * position / self.unit_per_tick

    def tick(self, position: float) -> int:
        """Compute the nearest integer tick to a joint position [rad or m].

        Raises:
            BadValueError: The position is not finite.
        """
        if not math.isfinite(position):
            raise BadValueError(f"The goal of {self.joint}", position, "a finite number")
        return math.floor(self.exact_tick(position) + 0.5)

    def format(self, position: float) -> str:
        """Format a position: ``101.3°`` or ``12.0 mm``."""
        return format_position(position, self.unit)

    def ticks_inside(self, lower: float, upper: float) -> tuple[int, int]:
        """Compute the lowest and highest ticks whose positions are in [lower, upper].

        Raises:
            BadValueError: There is no tick in the range.
        """
        a, b = sorted((self.exact_tick(lower), self.exact_tick(upper)))
        # Rounding must not exclude a limit that is exactly a tick.
        low, high = math.ceil(a - 1e-6), math.floor(b + 1e-6)
        if low > high:
            raise BadValueError(
                f"The range of {self.joint}", f"[{lower}, {upper}]", "a range that contains a tick"
            )
        return low, high


_MAGNET = 4096  # Dynamixel X and MX, STS: a full revolution
_POTENTIOMETER = 1024  # AX and SCS: 300° (200° on the SCS15)


@dataclass(frozen=True, slots=True)
class Encoder:
    """A position sensor: the number of its ticks, and the ticks per revolution of the horn."""

    ticks: int
    ticks_per_turn: float

    @property
    def wraps(self) -> bool:
        """Whether the count wraps around after a revolution."""
        return self.ticks == self.ticks_per_turn


def encoder_of(table: type[ControlTable]) -> Encoder:
    """Return the position sensor of a servo model."""
    full_turn = table.ticks_per_turn == _MAGNET
    return Encoder(_MAGNET if full_turn else _POTENTIOMETER, table.ticks_per_turn)


def wrapped_difference(start: int, end: int, ticks_per_turn: int) -> int:
    """Compute the shorter signed difference between two ticks modulo ``ticks_per_turn``.

    Half a revolution counts as negative: the result is in [-ticks_per_turn/2, ticks_per_turn/2).
    """
    return (end - start + ticks_per_turn // 2) % ticks_per_turn - ticks_per_turn // 2


def unwrap(last: int, reading: int, ticks_per_turn: int) -> int:
    """Unwrap a reading relative to the last reading, over any number of revolutions."""
    return last + wrapped_difference(last, reading, ticks_per_turn)


def unwrap_near(middle: int, reading: int, ticks_per_turn: int) -> int:
    """Return the reading shifted by full revolutions to within half a revolution of ``middle``."""
    return unwrap(middle, reading, ticks_per_turn)
