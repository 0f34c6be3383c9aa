"""How fast a joint may go."""

from __future__ import annotations

from dataclasses import dataclass

from ikservo.errors import BadValueError

__all__ = ["Pace"]


@dataclass(frozen=True, slots=True)
class Pace:
    """How fast a joint may go; metres instead of radians for a prismatic joint.

    Raises:
        BadValueError: One of the three is not a positive number.
    """

    speed_rad_s: float
    acceleration_rad_s2: float
    jerk_rad_s3: float

    def __post_init__(self) -> None:
        for name in ("speed_rad_s", "acceleration_rad_s2", "jerk_rad_s3"):
            value = getattr(self, name)
            if not 0.0 < value < float("inf"):
                raise BadValueError(f"The pace's {name}", value, "a positive number")

    @property
    def brake_s(self) -> float:
        """Return how long it takes from full speed to rest."""
        return (
            self.speed_rad_s / self.acceleration_rad_s2
            + self.acceleration_rad_s2 / self.jerk_rad_s3
        )

    def scaled(self, factor: float) -> Pace:
        """Return the pace in units that are ``1 / factor`` as long: a slide's, a gear's."""
        return Pace(
            self.speed_rad_s * factor,
            self.acceleration_rad_s2 * factor,
            self.jerk_rad_s3 * factor,
        )
