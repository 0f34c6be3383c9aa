"""Where the joints are, beat by beat, with lost answers bridged up to a bound."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ikservo.arm.streaming.asking import ask_all
from ikservo.errors import BusError, ServoSilentError
from ikservo.guard import Fence, Losses
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.readings import Readings
from ikservo.kinematics.se3 import Vector
from ikservo.registers import Role

__all__ = ["Feedback"]

_MOST_LOST = 3  # beats in a row


class Feedback:
    """Reads the joints' positions.

    Args:
        bus: The line.
        fences: One for each joint.

    Attributes:
        fresh: The ticks of the joints that answered last, by joint.
    """

    def __init__(self, bus: ServoBus, fences: Sequence[Fence]) -> None:
        self._bus, self._fences = bus, tuple(fences)
        self._ids = [fence.servo_id for fence in fences]
        self._last: dict[int, int] = {}
        self.fresh: dict[str, int] = {}
        self.begin()

    def begin(self) -> None:
        """Start counting losses anew: the arm was at rest."""
        self._losses = Losses([fence.joint for fence in self._fences], most=_MOST_LOST)

    @property
    def lost(self) -> tuple[str, ...]:
        """Return the joints whose last answer is missing."""
        return self._losses.lost

    def ticks(self) -> dict[str, int]:
        """Return every joint's tick, measured now.

        Raises:
            BusError: A servo does not answer, however often it is asked.
        """
        return self._by_joint(self._ask_all())

    def measure(self) -> Vector:
        """Return where the joints are (n,), measured now, rad or m.

        Raises:
            BusError: A servo does not answer, however often it is asked.
        """
        self._ask_all()
        return self._positions()

    def beat(self) -> Vector:
        """Return where the joints are (n,); one that did not answer, where it was last seen.

        Raises:
            ServoSilentError: A servo gave no answer for three beats in a row; names it.
        """
        readings = self._bus.sync_read(self._ids, Role.PRESENT_POSITION, raw=True)
        heard = dict(readings.values)
        try:
            self._note(heard)
        except ServoSilentError:
            heard |= self._asked_once_more(readings)
            self.begin()
            self._note(heard)
        return self._positions()

    def _asked_once_more(self, readings: Readings[int]) -> dict[int, int]:
        """Ask one of the silent with all patience: a busy machine is not a dead servo.

        Once it has answered the others are asked again, too: nobody has seen them for long.

        Raises:
            ServoSilentError: It is silent indeed; names all that are.
        """
        servo_id, *others = readings.errors
        try:
            first = {servo_id: self._bus.read(servo_id, Role.PRESENT_POSITION, raw=True)}
        except BusError:
            readings.complete()
            raise
        return first | dict(self._bus.sync_read(others, Role.PRESENT_POSITION, raw=True).values)

    def _note(self, heard: Mapping[int, int]) -> None:
        self._last |= heard
        self.fresh = {f.joint: heard[f.servo_id] for f in self._fences if f.servo_id in heard}
        self._losses.see(self.fresh)

    def _ask_all(self) -> Mapping[int, int]:
        heard = ask_all(self._bus, self._ids, Role.PRESENT_POSITION)
        self._last |= heard
        self.fresh = self._by_joint(heard)
        return heard

    def _by_joint(self, by_id: Mapping[int, int]) -> dict[str, int]:
        return {fence.joint: by_id[fence.servo_id] for fence in self._fences}

    def _positions(self) -> Vector:
        return np.array([f.joint_map.position(self._last[f.servo_id]) for f in self._fences])
