"""The permissions that an arm's owner gives an agent: consent mode, region, and budget."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

from ikservo.arm.own_motion import OwnMotion
from ikservo.clock import Clock
from ikservo.errors import InputError, RefusedError
from ikservo.planning.calibrated_arm import ZeroSource
from ikservo.planning.motions import MotionValue, MoveGripper, Wait
from ikservo.planning.path_constraint import UNCONSTRAINED, PathConstraint

LONGEST_SEARCH_S = 10.0
"""Longest path search that an agent can request."""


class Consent(StrEnum):
    """The kind of consent that a motion needs before it is executed."""

    NOTHING = "nothing"
    """No motion is allowed: the agent can only read and plan."""
    ASK = "ask"
    """A person allows each plan."""
    SIMULATOR = "simulator"
    """The owner allows every motion of a simulated arm."""
    SLOW = "slow"
    """The owner allows slow motions in a region, up to a budget; a person allows other motions."""


@dataclass(frozen=True, slots=True)
class Allowance:
    """The owner's permissions, which no tool can change.

    Attributes:
        consent: The kind of consent that a motion needs.
        within: The region in which the tip must stay, and other constraints on the tool.
        motions: Number of motions that are allowed without asking.
        minutes: Minutes from the start during which motions are allowed without asking.
    """

    consent: Consent = Consent.NOTHING
    within: PathConstraint = UNCONSTRAINED
    motions: int = 20
    minutes: float = 30.0

    def check(self, zeros: ZeroSource) -> None:
        """Check that the allowance fits an arm.

        Raises:
            InputError: A real arm was opened with ``simulator``, or ``slow`` has no region.
        """
        if self.consent is Consent.SIMULATOR and zeros is not ZeroSource.SIMULATED:
            hint = "Use --allow ask, or --allow slow with --keep-in."
            raise InputError("--allow simulator was given for a real arm.", hint)
        has_region = self.within.low_m is not None or self.within.above_m is not None
        if self.consent is Consent.SLOW and not has_region:
            raise InputError(
                "--allow slow needs a region.", "Add --keep-in X,Y,Z:X,Y,Z, or --keep-above Z."
            )

    def limited(self, motion: MotionValue[Any]) -> MotionValue[Any]:
        """Return a motion with the owner's limits: it stays in the region and is never replanned.

        Raises:
            RefusedError: The motion cannot be planned in advance, or cannot be kept in the region.
        """
        if isinstance(motion, OwnMotion):
            raise RefusedError(
                f"A person cannot approve {motion.kind}, because it cannot be planned in advance.",
                "Use move_to, move_line, move_joints or move_pose.",
            )
        if self.consent is Consent.SLOW:
            motion = motion.with_speed("slow")
        changes: dict[str, Any] = {}
        if getattr(motion, "replan", False):
            changes["replan"] = False
        if getattr(motion, "think_s", 0.0) > LONGEST_SEARCH_S:
            changes["think_s"] = LONGEST_SEARCH_S
        if self.within.constrains and not isinstance(motion, MoveGripper | Wait):
            own = getattr(motion, "within", None)
            if own is None:
                text = f"A motion of kind {motion.kind} cannot be kept within the owner's region."
                raise RefusedError(text, "Use move_to, move_line, move_joints or move_pose.")
            if own.constrains:
                raise RefusedError(
                    "The owner has already constrained the tool.", "Leave out `within`."
                )
            changes["within"] = self.within
        return replace(motion, **changes) if changes else motion


class Budget:
    """The number of motions that are still allowed without asking, until a given time."""

    def __init__(self, allowance: Allowance, clock: Clock) -> None:
        self._left, self._clock = allowance.motions, clock
        self._end_s = clock.now_s() + 60.0 * allowance.minutes
        self._lock = threading.Lock()

    def take(self, motions: int) -> bool:
        """Spend motions from the budget; return False and spend none if too few are left."""
        with self._lock:
            is_covered = self.covers(motions)
            self._left -= motions * is_covered
            return is_covered

    def covers(self, motions: int) -> bool:
        """Check whether the remaining budget covers a number of motions now."""
        return motions <= self._left and self._clock.now_s() <= self._end_s

    def left(self) -> Mapping[str, float]:
        """Return the remaining motions and minutes."""
        minutes = max(0.0, (self._end_s - self._clock.now_s()) / 60.0)
        return {"motions": self._left, "minutes": round(minutes, 1)}
