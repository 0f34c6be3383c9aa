"""Plans that an agent has made; each can be executed once before it expires."""

from __future__ import annotations

import secrets
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from ikservo.clock import Clock
from ikservo.errors import RefusedError, UnknownNameError
from ikservo.kinematics.arrays import Vector
from ikservo.planning.motion_plan import MotionPlan
from ikservo.planning.motions import MotionValue

LIFETIME_S = 300.0  # after this time a plan has expired
MAX_PLANS = 50  # stored at most; the oldest plan is dropped first


class Answer(StrEnum):
    """A person's answer to a plan."""

    NONE = "none"
    YES = "yes"
    NO = "no"


@dataclass(slots=True, eq=False)
class OfferedPlan:
    """A plan that is waiting to be executed.

    Attributes:
        motions: The motions; several for a program.
        plan: The plan of a single motion; None for the gripper, a wait, and a program.
        summary: The plan in words, one line for each motion.
        stops: The number of times the arm had been stopped before the plan was made.
        start: The joints (n,) where a program begins; None for a single motion.
        made_s: The time at which the plan was stored.
        id: An identifier that cannot be guessed.
        answer: The person's answer.
        answered_by: The person or option that answered.
        is_asked: Whether a person has been asked for consent.
        is_used: Whether the plan was executed.
    """

    motions: Sequence[MotionValue[Any]]
    plan: MotionPlan | None
    summary: Sequence[str]
    stops: int = 0
    start: Vector | None = None
    made_s: float = 0.0
    id: str = field(default_factory=lambda: secrets.token_hex(4))
    answer: Answer = Answer.NONE
    answered_by: str = ""
    is_asked: bool = False
    is_used: bool = False


class PlanStore:
    """The plans of one server; thread-safe."""

    def __init__(self, clock: Clock) -> None:
        self._clock, self._lock = clock, threading.RLock()
        self._plans: dict[str, OfferedPlan] = {}

    def offer(self, offered: OfferedPlan) -> OfferedPlan:
        """Store a plan, and return it."""
        offered.made_s = self._clock.now_s()
        with self._lock:
            while len(self._plans) >= MAX_PLANS:
                del self._plans[next(iter(self._plans))]
            self._plans[offered.id] = offered
        return offered

    def find(self, plan_id: str) -> OfferedPlan:
        """Return a plan that can still be executed.

        Raises:
            UnknownNameError: There is no such plan.
            RefusedError: The plan has expired, was executed, or was refused by a person.
        """
        with self._lock:
            offered = self._plans.get(plan_id)
        if offered is None:
            raise UnknownNameError("plan", plan_id, tuple(self._plans))
        if offered.is_used:
            raise RefusedError(f"Plan {plan_id} has already been used.", "Make another plan.")
        if offered.answer is Answer.NO:
            raise RefusedError(f"A person refused plan {plan_id}.", "Ask what to change.")
        if self._clock.now_s() - offered.made_s > LIFETIME_S:
            raise RefusedError(f"Plan {plan_id} has expired.", "Plan again.")
        return offered

    def take(self, plan_id: str) -> OfferedPlan:
        """Mark a plan as used and return it for execution. Raises the same errors as ``find``."""
        with self._lock:
            offered = self.find(plan_id)
            offered.is_used = True
            self.withdraw_questions()
        return offered

    def withdraw_questions(self) -> None:
        """Withdraw all requests for consent after a motion or a stop: the arm is now elsewhere."""
        with self._lock:
            for each in self._plans.values():
                each.is_asked = False

    def asked(self) -> list[OfferedPlan]:
        """Return the plans that are waiting for a person's answer."""
        with self._lock:
            plans = list(self._plans.values())
        oldest_s = self._clock.now_s() - LIFETIME_S
        waiting = (each for each in plans if each.is_asked and not each.is_used)
        return [each for each in waiting if each.answer is Answer.NONE and each.made_s >= oldest_s]

    def answer(self, plan_id: str, answer: Answer, answered_by: str) -> None:
        """Store a person's answer; a refusal revokes earlier consent. Raises as ``find`` does."""
        with self._lock:
            offered = self.find(plan_id)
            if offered.answer is Answer.NONE or answer is Answer.NO:
                offered.answer, offered.answered_by = answer, answered_by
