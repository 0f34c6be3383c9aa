"""What is around an arm: things, and other arms, of which one moves at a time."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from threading import Lock, RLock
from typing import Protocol

import numpy as np

from ikservo.errors import RefusedError
from ikservo.guard import CollisionChecker
from ikservo.guard.sag import Sag
from ikservo.kinematics.arrays import Vector
from ikservo.kinematics.collision_body import CollisionBody
from ikservo.model.model import Obstacle


class Turn:
    """Which of two arms moves: one at a time, and none waits for the other."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._arm: object = None
        self._times = 0

    def is_of_other(self, arm: object) -> bool:
        """Return whether the other one moves."""
        return self._arm is not None and self._arm is not arm

    @contextmanager
    def taken(self, arm: object, other: str) -> Generator[None]:
        """Let an arm move in the block.

        Args:
            arm: One of the two arms.
            other: The name of the other one.

        Raises:
            RefusedError: The other one moves.
        """
        with self._lock:
            if self.is_of_other(arm):
                raise other_moves(other)
            self._arm, self._times = arm, self._times + 1
        try:
            yield
        finally:
            with self._lock:
                self._times -= 1
                if not self._times:
                    self._arm = None


def other_moves(name: str) -> RefusedError:
    """Return the refusal of an arm that another one, of that name, would have to make way for."""
    return RefusedError(
        f"{name}, which this arm can reach, is moving.",
        "Only one of the two may move at a time. Wait until it is at rest.",
    )


class AnotherArm(Protocol):
    """Another arm that an arm can reach."""

    @property
    def name(self) -> str:
        """Its name, for messages."""
        ...

    @property
    def turn(self) -> Turn:
        """Which of the two moves."""
        ...

    def things(self, arm: object) -> Sequence[Obstacle]:
        """Measure where its links are, in the base frame of an arm, which takes turns with it.

        Raises:
            RefusedError: It moves, or where it is cannot be measured.
        """
        ...


@dataclass(slots=True, eq=False)
class Surroundings:
    """What is around an arm now.

    Attributes:
        checker: Checks paths among it; a change puts another one here, and leaves those alone that
            somebody plans with. None where paths are not checked.
        others: The other arms that it can reach.
        contacts: The pairs of the checker, and how deep each of them was when the arm came into
            contact (pairs,), as negative distances [m], -inf for no contact; None: not known.
    """

    checker: CollisionChecker | None
    others: tuple[AnotherArm, ...] = ()
    contacts: tuple[Sequence[tuple[str, str]], Vector] | None = None
    _body: CollisionBody | None = None
    _things: tuple[Obstacle, ...] = ()
    _sag: Sag | None = None
    _seen: tuple[Obstacle, ...] = ()
    _lock: RLock = field(default_factory=RLock, repr=False)

    def place(self, body: CollisionBody, things: Sequence[Obstacle], sag: Sag | None) -> None:
        """Put the arm's body among things; other arms are where they were seen last."""
        with self._lock:
            self._body, self._things, self._sag = body, tuple(things), sag
            self._put_among(self._seen)

    def contacts_began_m(self) -> Vector | None:
        """Return how deep each pair of the checker was when it came into contact (pairs,), or None.

        Contacts begin anew where there are other things.
        """
        if self.contacts is None or self.checker is None or self.contacts[0] != self.checker.pairs:
            return None
        return self.contacts[1]

    def note_contacts(self, q: Vector) -> None:
        """Note which contacts an arm at rest (dof,) has come into, and which have ended."""
        if self.checker is not None:
            gap_m, known_m = self.checker.distances(q[None])[0], self.contacts_began_m()
            began_m = gap_m if known_m is None else np.where(np.isinf(known_m), gap_m, known_m)
            self.contacts = self.checker.pairs, np.where(gap_m < 0.0, began_m, -np.inf)

    def look(self) -> None:
        """Look where the other arms are now.

        Raises:
            RefusedError: Another arm moves, or where it is is not known.
        """
        if self.others:
            self._put_among([thing for each in self.others for thing in each.things(self)])

    def set_others(self, others: Sequence[AnotherArm]) -> None:
        """Change which other arms it can reach; they are looked at before each motion."""
        self.others = tuple(others)
        self._put_among([])

    def _put_among(self, seen: Sequence[Obstacle]) -> None:
        with self._lock:
            self._seen = tuple(seen)
            if self.checker is not None and self._body is not None:
                self.checker = self.checker.in_scene(self._body, [*self._things, *seen], self._sag)

    @contextmanager
    def in_turn(self) -> Generator[None]:
        """Let no other arm move in the block.

        Raises:
            RefusedError: Another arm moves.
        """
        with ExitStack() as turns:
            for other in self.others:
                turns.enter_context(other.turn.taken(self, other.name))
            yield

    @contextmanager
    def undisturbed(self) -> Generator[None]:
        """Let no other arm move in the block, and keep out of where they are.

        Raises:
            RefusedError: Another arm moves, or where it is is not known.
        """
        with self.in_turn():
            self.look()
            yield
