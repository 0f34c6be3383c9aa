"""A touch-off as a pure machine: readings and answers in, the next question or a review out.

``touch -> review``. It knows no terminal, no bus and no clock, like the calibration by hand, so
a terminal, a page and a script drive the very same conversation. Every step returns a new one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ikservo.calibration import JointMap
from ikservo.calibration.sweeping.stillness import Stillness
from ikservo.errors import CalibrationError
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Vector
from ikservo.model.touch.estimate import FEWEST, Estimate, estimate
from ikservo.model.touch.grid import Place
from ikservo.model.touch.touches import Touch

__all__ = ["Touching"]

_MOVED_TICKS = 20


@dataclass(frozen=True, slots=True, eq=False)
class Touching:
    """The state of one touch-off.

    Attributes:
        chain: The arm as described.
        present: The arm as it is believed at present.
        maps: What the ticks of each of the chain's joints mean.
        places: What is still to be touched, in order.
        touches: What has been touched.
        stillness: What was read in the last half second.
        ticks: By servo id, where the last touch was taken; empty before the first.
        found: What the touches say, once they are reviewed.
        before: The state before the person's last answer.
    """

    chain: Chain
    present: Chain
    maps: tuple[JointMap, ...]
    places: tuple[Place, ...]
    touches: tuple[Touch, ...] = ()
    stillness: Stillness = field(default_factory=Stillness)
    ticks: Mapping[int, float] = field(default_factory=dict[int, float])
    found: Estimate | None = None
    before: Touching | None = None

    @classmethod
    def begin(
        cls, chain: Chain, present: Chain, maps: Sequence[JointMap], places: Sequence[Place]
    ) -> Touching:
        """Return a touch-off at its first point."""
        return cls(chain, present, tuple(maps), tuple(places))

    # --- what is so now ---

    @property
    def asked(self) -> Place | None:
        """Return the point that the tip shall be put on next; None after the last."""
        return self.places[0] if self.places and self.found is None else None

    @property
    def still(self) -> bool:
        """Return whether nothing has moved for half a second."""
        return self.stillness.still()

    @property
    def moved(self) -> bool:
        """Return whether the arm has been moved since the last touch."""
        if not self.ticks or not self.stillness.seen:
            return True
        here = self.stillness.seen[-1][1].items()
        return any(abs(tick - self.ticks[servo_id]) > _MOVED_TICKS for servo_id, tick in here)

    # --- what can happen ---

    def read(self, at_s: float, ticks: Mapping[int, int]) -> Touching:
        """Take a reading of the servos, ticks as reported by id, at a time [s]."""
        return replace(self, stillness=self.stillness.with_reading(at_s, ticks))

    def touch(self) -> Touching:
        """Take where the arm is held for the point that is asked for.

        Raises:
            CalibrationError: The arm still moves, or nothing is asked for.
        """
        if self.asked is None:
            raise CalibrationError("Every point has been touched.", "Evaluate (a), or undo (u).")
        if not self.still:
            raise CalibrationError("The arm is still moving.", "Hold it still for half a second.")
        ticks = self.stillness.middle()
        touch = Touch(self._joints(ticks), self.asked.name, self.asked.position_m)
        return replace(
            self, touches=(*self.touches, touch), places=self.places[1:], ticks=ticks, before=self
        )

    def skip(self) -> Touching:
        """Leave the point out that is asked for."""
        return replace(self, places=self.places[1:], before=self)

    def undo(self) -> Touching:
        """Take the last answer back."""
        if self.before is None:
            return self
        return replace(self.before, stillness=self.stillness)

    def accept(self) -> Touching:
        """End the touching and work out what it says.

        Raises:
            CalibrationError: There are too few touches, or they contradict each other.
        """
        return replace(self, found=estimate(self.chain, self.touches, self.present), before=self)

    @property
    def enough(self) -> bool:
        """Return whether the touches could be reviewed."""
        return len(self.touches) >= FEWEST

    def _joints(self, ticks: Mapping[int, float]) -> Vector:
        return np.array([joint.position(ticks[joint.servo_id]) for joint in self.maps])
