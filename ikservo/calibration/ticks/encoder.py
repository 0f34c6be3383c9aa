"""The position sensor of a servo: how many ticks it tells apart and whether they wrap."""

from __future__ import annotations

from dataclasses import dataclass

from ikservo.registers import ServoTable

__all__ = ["Encoder", "encoder_of"]

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


def encoder_of(table: type[ServoTable]) -> Encoder:
    """Return the position sensor of a servo model."""
    whole = table.ticks_per_turn == _MAGNET
    return Encoder(_MAGNET if whole else _POTENTIOMETER, table.ticks_per_turn)
