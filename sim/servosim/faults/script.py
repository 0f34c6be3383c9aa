"""The faults of a line: which are in force, and what they do to what passes."""

from __future__ import annotations

import random
from dataclasses import dataclass
from typing import TYPE_CHECKING

from servosim.errors import FaultError
from servosim.faults.events import EVENTS
from servosim.faults.fault import Fault
from servosim.faults.replies import LOST, REPLIES, Arrival

if TYPE_CHECKING:
    from servosim.line import Line
    from servosim.servo import Servo

__all__ = ["FaultScript"]


@dataclass(slots=True)
class _Running:
    """A fault of replies or instructions, and how often it has struck."""

    fault: Fault
    strikes: int = 0

    def strikes_now(self, at_s: float, chance: random.Random) -> bool:
        fault = self.fault
        inside = fault.at_s <= at_s < fault.at_s + fault.for_s and self.strikes < fault.count
        if not inside or (fault.probability < 1.0 and chance.random() >= fault.probability):
            return False
        self.strikes += 1
        return True


class FaultScript:
    """Everything that goes wrong on one line; the same seed makes the same things go wrong."""

    def __init__(self, line: Line, seed: int) -> None:
        self._line = line
        self._random = random.Random(seed)  # noqa: S311 - chance of faults
        self._replies: list[_Running] = []
        self._lost: list[_Running] = []

    def add(self, fault: Fault) -> None:
        """Let a fault happen at its time, or now when that has passed.

        Raises:
            FaultError: No such kind of fault.
        """
        if fault.kind in REPLIES:
            self._replies.append(_Running(fault))
        elif fault.kind == LOST:
            self._lost.append(_Running(fault))
        elif fault.kind in EVENTS:
            self._line.world.at(fault.at_s, lambda: self._begin(fault))
        else:
            known = ", ".join((*REPLIES, LOST, *EVENTS))
            raise FaultError(f"no fault is named {fault.kind!r}; known: {known}")

    def clear(self) -> None:
        """Forget the faults of replies and instructions."""
        self._replies.clear()
        self._lost.clear()

    def instruction_lost(self, at_s: float) -> bool:
        """Say whether an instruction does not come through."""
        return any(running.strikes_now(at_s, self._random) for running in self._lost)

    def replies(self, servo: Servo | None, at_s: float, data: bytes) -> list[Arrival]:
        """Return what reaches the host of a reply: delays behind its time, and bytes."""
        arrivals: list[Arrival] = [(0.0, data)]
        if not self._replies:
            return arrivals
        for running in self._replies:
            concerns = servo is not None and running.fault.id in (None, servo.id)
            if concerns and data and running.strikes_now(at_s, self._random):
                arrivals = [
                    (delay_s + more_s, altered)
                    for delay_s, piece in arrivals
                    for more_s, altered in REPLIES[running.fault.kind](
                        piece, running.fault, self._random
                    )
                ]
        return arrivals

    def _begin(self, fault: Fault) -> None:
        end = EVENTS[fault.kind](self._line, fault)
        world = self._line.world
        world.wake()
        world.at(world.time_s + fault.for_s, end)
