"""What stands between a servo's horn and the joint it moves: nothing, a gear, a rack or a crank."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

__all__ = ["DIRECT", "CrankAndRod", "Ratio", "Transmission"]


class Transmission(Protocol):
    """Between the angle of a horn [rad] and the coordinate of its joint [rad or m]."""

    @property
    def slides(self) -> bool:
        """Whether the joint is prismatic."""
        ...

    def position(self, turned_rad: float) -> float:
        """Return where the joint is when the horn has turned so far from joint zero."""
        ...

    def turned_rad(self, position: float) -> float:
        """Return how far the horn has turned when the joint is there."""
        ...

    def slope(self, turned_rad: float) -> float:
        """Return by how much the joint moves for a small turn of the horn, rad or m a rad."""
        ...


@dataclass(frozen=True, slots=True)
class Ratio:
    """A horn on the joint itself, a gear, or a rack: the same everywhere.

    Attributes:
        per_rad: How far the joint goes for one radian of the horn, rad or m.
        slides: Whether the joint is prismatic.
    """

    per_rad: float = 1.0
    slides: bool = False

    def position(self, turned_rad: float) -> float:
        """Return where the joint is."""
        return turned_rad * self.per_rad

    def turned_rad(self, position: float) -> float:
        """Return how far the horn has turned."""
        return position / self.per_rad

    def slope(self, turned_rad: float) -> float:
        """Return the ratio."""
        return self.per_rad


@dataclass(frozen=True, slots=True)
class CrankAndRod:
    """A crank that pushes a slide by a rod: `x = r cos φ + sqrt(l² - r² sin² φ)`.

    The horn turns φ back from its angle at joint zero, so that a growing angle pushes outwards;
    near its dead centres the slide hardly moves.

    Attributes:
        radius_m: From the horn's axis to the pin.
        rod_m: From the pin to the slide; longer than the radius.
        zero_rad: φ at joint zero.
    """

    radius_m: float
    rod_m: float
    zero_rad: float

    @property
    def slides(self) -> bool:
        """Whether the joint is prismatic: always."""
        return True

    def position(self, turned_rad: float) -> float:
        """Return where the slide is."""
        return self._x(self.zero_rad - turned_rad) - self._x(self.zero_rad)

    def turned_rad(self, position: float) -> float:
        """Return how far the horn has turned; out of reach, where the slide comes nearest."""
        x, r, rod = position + self._x(self.zero_rad), self.radius_m, self.rod_m
        x = min(rod + r, max(rod - r, x))
        cosine = (x * x + r * r - rod * rod) / (2.0 * r * x)
        return self.zero_rad - math.acos(min(1.0, max(-1.0, cosine)))

    def slope(self, turned_rad: float) -> float:
        """Return metres a radian, never less than a hundredth of the radius."""
        phi = self.zero_rad - turned_rad
        across, along = self.radius_m * math.sin(phi), self.radius_m * math.cos(phi)
        steep = across + across * along / math.sqrt(self.rod_m**2 - across**2)
        least = 0.01 * self.radius_m
        return math.copysign(max(abs(steep), least), steep)

    def _x(self, phi: float) -> float:
        across = self.radius_m * math.sin(phi)
        return self.radius_m * math.cos(phi) + math.sqrt(self.rod_m**2 - across**2)


DIRECT = Ratio()
"""The horn is the joint."""
