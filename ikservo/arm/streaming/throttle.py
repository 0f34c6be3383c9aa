"""How fast the time of a motion passes: slower when a stop is wanted or the machine is late."""

from __future__ import annotations

from ikservo.errors import RefusedError

__all__ = ["BRAKE_S", "Throttle"]

BRAKE_S = 0.25
"""How long a motion takes from full speed to a stop, and from a stop to full speed."""

# After a gap like this nothing is made up for: the motion starts anew from where it stands.
_STALL_S = 0.1
# Up to this gap a late beat is made up for.
_LONGEST_S = 0.02
# A beat later than this counts; so many more late beats than good ones are too many.
_LATE_S, _LATE_BEATS = 0.025, 50


class Throttle:
    """Turns the time of the clock into the time of a motion.

    A motion whose time passes slower stays on its path and inside every limit: this is how it is
    braked, and how it starts again after the program was held up.

    Args:
        beat_s: Between two goals when all is well.

    Attributes:
        rate: Seconds of the motion in one of the clock, 0 to 1.
        late_s: How much longer than its period the beat before took.
    """

    def __init__(self, beat_s: float) -> None:
        self._beat_s = beat_s
        self._late_beats = 0
        self.late_s = 0.0
        self.rate = 1.0

    @property
    def stands(self) -> bool:
        """Return whether the motion has been braked to a stop."""
        return self.rate <= 0.0

    def step(self, elapsed_s: float, *, braking: bool) -> float:
        """Count one control cycle, adapt the rate to it, and say how far the motion goes on.

        Called once a cycle, before the lag of the joints is looked at.

        Args:
            elapsed_s: Since the cycle before, by the clock.
            braking: A stop is wanted.

        Returns:
            The time by which the motion may go on, seconds.
        """
        self._count(elapsed_s)
        gap_s = min(elapsed_s, max(_LONGEST_S, 2.0 * self._beat_s))
        if elapsed_s > _STALL_S:
            self.rate = 0.0
        elif braking or self._late_beats > _LATE_BEATS:
            self.rate = max(0.0, self.rate - gap_s / BRAKE_S)
        else:
            self.rate = min(1.0, self.rate + gap_s / BRAKE_S)
        return self.rate * gap_s

    def check(self) -> None:
        """Raise once a machine that is too slow has braked the motion to a stop.

        Raises:
            RefusedError: It is.
        """
        if self._late_beats > _LATE_BEATS and self.stands:
            raise RefusedError(
                f"The computer is too busy for a control cycle of {self._beat_s * 1000:.1f} ms; "
                "the arm was slowed down and stopped.",
                "Reduce the computer's load, then move again.",
            )

    def _count(self, elapsed_s: float) -> None:
        self.late_s = max(0.0, elapsed_s - self._beat_s)
        late = self.late_s > _LATE_S
        self._late_beats = max(0, self._late_beats + (1 if late else -1))
