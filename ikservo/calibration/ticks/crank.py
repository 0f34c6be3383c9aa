"""A slide that its servo moves by a crank and a rod."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ikservo.errors import BadValueError

__all__ = ["Crank"]


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
        return self._reach(self.zero_rad - turned_rad) - self._reach(self.zero_rad)

    def turned_rad(self, position: float) -> float:
        """Return how far the horn has turned from zero [rad] at a position [m]."""
        x, r, rod = position + self._reach(self.zero_rad), self.radius_m, self.rod_m
        cosine = (x * x + r * r - rod * rod) / (2.0 * r * x)
        return self.zero_rad - math.acos(min(1.0, max(-1.0, cosine)))

    def until_dead_centre(self, turned_rad: float) -> float:
        """Return a turn of the horn from zero, cut where the slide would begin to come back."""
        return min(self.zero_rad, max(self.zero_rad - math.pi, turned_rad))

    @property
    def steepest_m_per_rad(self) -> float:
        """Return the most that the slide moves for a small turn of the horn."""
        angles = (math.pi * k / 180.0 for k in range(181))
        return max(-self._slope(angle) for angle in angles)

    def _reach(self, angle: float) -> float:
        across = self.radius_m * math.sin(angle)
        return self.radius_m * math.cos(angle) + math.sqrt(self.rod_m**2 - across**2)

    def _slope(self, angle: float) -> float:
        across, along = self.radius_m * math.sin(angle), self.radius_m * math.cos(angle)
        return -across - across * along / math.sqrt(self.rod_m**2 - across**2)
