"""One flight: from the moment Live is thrown until the arm holds again."""

from __future__ import annotations

from typing import Protocol

from ikservo.arm.streaming.beat import Beat
from ikservo.clock import Clock
from ikservo.errors import RefusedError
from ikservo.kinematics.se3 import Vector
from ikservo.view.session.readout import Wish

__all__ = ["Flight", "Watcher"]


class Watcher(Protocol):
    """Who is told what the arm does, and knows what the person wants now."""

    @property
    def wish(self) -> Wish:
        """Return what the arm was told last."""
        ...

    def see(self, beat: Beat) -> None:
        """Hear of a beat."""
        ...

    def note(self, words: str) -> None:
        """Hear what the person should know."""
        ...


class Flight:
    """Leads the arm after the person's wishes (``ikservo.arm.skills.leading.Leader``).

    Args:
        watcher: Who has the wishes and hears of every beat.
        clock: Dates them.
        dead_man_s: How long a wish lasts without a sign of life.

    Attributes:
        number: Which flight it is.
        silent: Whether it ended because nobody gave a sign of life.
    """

    def __init__(self, watcher: Watcher, clock: Clock, dead_man_s: float) -> None:
        self._watcher, self._clock, self._dead_man_s = watcher, clock, dead_man_s
        self.number, self.speed = watcher.wish.flight, watcher.wish.speed
        self._here: Vector | None = None
        self._gone = self.silent = False

    def goal(self, beat: Beat) -> Vector | None:
        """Return where the joints shall be (n,); None once the flight is over."""
        self._watcher.see(beat)
        wish = self._watcher.wish
        if self._here is None:
            self._here = beat.goals.copy()
        self.silent = self._clock.now_s() - wish.fresh_s > self._dead_man_s
        if self.silent or self.over or wish.speed != self.speed or self._let_go(wish):
            return None
        return self._here if wish.goal is None else wish.goal

    def _let_go(self, wish: Wish) -> bool:
        """Return whether the goal was taken back: the arm brakes, and stays where that ends."""
        self._gone = self._gone or wish.goal is not None
        return self._gone and wish.goal is None

    @property
    def over(self) -> bool:
        """Return whether Live was switched off, maybe on again, since it began."""
        wish = self._watcher.wish
        return not wish.live or wish.flight != self.number

    def refused(self, error: RefusedError) -> None:
        """Tell why the guard would not have a goal."""
        self._watcher.note(f"{error.message} {error.command_hint}")
