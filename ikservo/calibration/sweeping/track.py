"""One servo while a hand moves its joint: where it has been, counted across the seam."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ikservo.calibration.ticks.seam import unwrapped

__all__ = ["Track"]

# Between two readings a hand turns a joint far less than a quarter turn. After a gap in them
# the turn is ambiguous only if the joint could have gone the other way round meanwhile.
_LONGEST_STEP = 1024
_FASTEST_TURNS_PER_S = 1.6  # of a hand: 10 rad/s


@dataclass(frozen=True, slots=True)
class Track:
    """Where a servo is and was, in bare ticks counted on over the seam.

    Attributes:
        turn: Ticks in a turn, or 0 for a sensor that has no seam.
        tick: Where it is.
        low: The lowest tick seen.
        high: The highest.
        at_s: When it was last read.
        lost: Whether it was moved too fast to be followed; measuring starts again.
    """

    turn: int
    tick: int
    low: int
    high: int
    at_s: float
    lost: bool = False

    @classmethod
    def from_here(cls, turn: int, tick: int, at_s: float) -> Track:
        """Return a track that begins at a tick."""
        return cls(turn, tick, tick, tick, at_s)

    @property
    def width(self) -> int:
        """Return the ticks between the ends that were seen."""
        return self.high - self.low

    def seen(self, reading: int, at_s: float) -> Track:
        """Return the track with one more reading."""
        tick = unwrapped(self.tick, reading, self.turn) if self.turn else reading
        strayed = self.turn and abs(tick - self.tick) > _LONGEST_STEP
        other_way = self.turn - abs(tick - self.tick)
        ambiguous = other_way <= _FASTEST_TURNS_PER_S * self.turn * (at_s - self.at_s)
        return replace(
            self,
            tick=tick,
            low=min(self.low, tick),
            high=max(self.high, tick),
            at_s=at_s,
            lost=self.lost or bool(strayed or (self.turn and ambiguous)),
        )

    def counted(self, tick: int, at_s: float) -> Track:
        """Return the track with one more reading whose turn is known."""
        low, high = min(self.low, tick), max(self.high, tick)
        return replace(self, tick=tick, low=low, high=high, at_s=at_s)

    def again(self) -> Track:
        """Return a track that has seen nothing but where it is; the count goes on."""
        return replace(self, low=self.tick, high=self.tick, lost=False)

    def with_range_of(self, earlier: Track) -> Track:
        """Return the track where it is, with what was seen earlier, good or lost."""
        lost = self.lost or earlier.lost
        return replace(self, low=earlier.low, high=earlier.high, lost=lost)
