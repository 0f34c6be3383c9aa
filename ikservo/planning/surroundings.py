"""The surroundings of an arm: obstacles and other arms; only one arm moves at a time."""

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
from ikservo.model.arm_model import Obstacle


class Turn:
    """A lock shared by two arms: only one arm moves at a time, and neither waits for the other."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._arm: object = None
        self._times = 0

    def is_of_other(self, arm: object) -> bool:
        """Check whether the other arm is moving."""
        return self._arm is not None and self._arm is not arm

    @contextmanager
    def taken(self, arm: object, other: str) -> Generator[None]:
        """Hold the lock for an arm while the block runs; ``other`` is the other arm's name.

        Raises:
            RefusedError: The other arm is moving.
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
    """Return the error for an arm that must not move while the arm with this name is moving."""
    return RefusedError(
        f"{name}, which is in reach, is moving.",
        "Only one of the two arms may move at a time. Wait until the other arm is at rest.",
    )


class AnotherArm(Protocol):
    """Another arm in reach of this one."""

    @property
    def name(self) -> str:
        """The name for messages."""
        ...

    @property
    def turn(self) -> Turn:
        """The lock that the two arms share."""
        ...

    def things(self, arm: object) -> Sequence[Obstacle]:
        """Measure the other arm's links; return them as obstacles in the base frame of ``arm``.

        Raises:
            RefusedError: The other arm is moving, or its position cannot be measured.
        """
        ...


@dataclass(slots=True, eq=False)
class Surroundings:
    """The present surroundings of an arm.

    Attributes:
        checker: Checks paths; None if paths are not checked. A change replaces the checker;
            checkers that are in use do not change.
        others: The other arms in reach.
        contacts: The pairs of the checker, and the depths (pairs,) at which their contacts began,
            as negative distances [m], -inf without contact; None if unknown.
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
        """Set the arm's body and the obstacles around it; other arms keep their last places."""
        with self._lock:
            self._body, self._things, self._sag = body, tuple(things), sag
            self._put_among(self._seen)

    def contacts_began_m(self) -> Vector | None:
        """Return the depth (pairs,) at which each pair came into contact; None if unknown.

        It is unknown if nothing is recorded, or if the checked pairs have changed.
        """
        if self.contacts is None or self.checker is None or self.contacts[0] != self.checker.pairs:
            return None
        return self.contacts[1]

    def note_contacts(self, q: Vector) -> None:
        """Update the recorded contacts of an arm that rests at joints (dof,)."""
        if self.checker is not None:
            gap_m, known_m = self.checker.distances(q[None])[0], self.contacts_began_m()
            began_m = gap_m if known_m is None else np.where(np.isinf(known_m), gap_m, known_m)
            self.contacts = self.checker.pairs, np.where(gap_m < 0.0, began_m, -np.inf)

    def look(self) -> None:
        """Measure the present position of the other arms.

        Raises:
            RefusedError: Another arm is moving, or its position is unknown.
        """
        if self.others:
            self._put_among([thing for each in self.others for thing in each.things(self)])

    def set_others(self, others: Sequence[AnotherArm]) -> None:
        """Change the set of other arms in reach; they are measured before each motion."""
        self.others = tuple(others)
        self._put_among([])

    def _put_among(self, seen: Sequence[Obstacle]) -> None:
        with self._lock:
            self._seen = tuple(seen)
            if self.checker is not None and self._body is not None:
                self.checker = self.checker.in_scene(self._body, [*self._things, *seen], self._sag)

    @contextmanager
    def in_turn(self) -> Generator[None]:
        """Keep other arms from moving in the block.

        Raises:
            RefusedError: Another arm is moving.
        """
        with ExitStack() as turns:
            for other in self.others:
                turns.enter_context(other.turn.taken(self, other.name))
            yield

    @contextmanager
    def undisturbed(self) -> Generator[None]:
        """Keep other arms from moving in the block, and avoid them.

        Raises:
            RefusedError: Another arm is moving, or its position is unknown.
        """
        with self.in_turn():
            self.look()
            yield
