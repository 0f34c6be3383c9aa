"""Following a stream of wishes: one at each beat, until it ends or falls silent."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import repeat

from ikservo.arm.arriving.settling import settle
from ikservo.arm.reports import Progress
from ikservo.arm.skills.leading import lead, standing
from ikservo.arm.skills.tracking import Tracker, Wish
from ikservo.arm.skills.workings import Workings
from ikservo.arm.streaming.beat import Beat
from ikservo.errors import RefusedError
from ikservo.guard import DEAD_MAN_TIMEOUT_S, DeadMan
from ikservo.kinematics.se3 import Vector

__all__ = ["FollowReport", "follow"]


@dataclass(frozen=True, slots=True, eq=False)
class FollowReport:
    """How a stream of wishes was followed.

    Attributes:
        wishes: How many there were.
        unreached: How many of them were out of reach; the arm went as near as it could.
        refused: How often the guard would not have a new one; the arm stayed with the one before.
        reason: Why the last of those was refused.
        ended: Why it ended: the stream's end, or its silence.
        measured_rad: Where the joints are in the end, corrected, rad or m by name.
        measured_tip_m: Where that puts the tip (3,), metres.
        duration_s: From the first wish to rest, the correction included.
    """

    wishes: int
    unreached: int
    refused: int
    reason: str
    ended: str
    measured_rad: dict[str, float]
    measured_tip_m: Vector
    duration_s: float


class _Follower:
    """Says where the stream wants the joints, beat by beat."""

    def __init__(
        self,
        arm: Workings,
        wishes: Iterable[Wish | None],
        on_progress: Callable[[Progress], None] | None,
    ) -> None:
        self._arm, self._wishes, self._on_progress = arm, iter(wishes), on_progress
        self._tracker = Tracker(arm.chain, arm.servos.names)
        self._dead_man = DeadMan()
        self._goal: Vector | None = None
        self.count = self.unreached = self.refusals = 0
        self.reason = self.ended = ""

    def goal(self, beat: Beat) -> Vector | None:
        """Return where to go (n,); None after too long a silence."""
        if self._goal is None:
            self._goal = standing(self._arm, beat)
            self._dead_man.fresh(self._arm.now_s())
        if self._on_progress:
            self._on_progress(self._arm.progress(beat))
        return self._heard(self._next(), self._goal)

    def refused(self, error: RefusedError) -> None:
        """Count a wish that the guard would not have."""
        self.refusals += 1
        self.reason = error.message

    def _next(self) -> Wish | None:
        """Return the next wish; a stream that has ended is one that is silent from then on."""
        try:
            return next(self._wishes)
        except StopIteration:
            self.ended, self._wishes = "end of the targets", repeat(None)
            return None

    def _heard(self, wish: Wish | None, last: Vector) -> Vector | None:
        now_s = self._arm.now_s()  # a stream may have kept us waiting
        if self._dead_man.check(now_s):
            self.ended = self.ended or f"no target for {DEAD_MAN_TIMEOUT_S} s"
            return None
        if wish is not None:
            self._dead_man.fresh(now_s)
            self._goal, reached = self._tracker.joints(wish, last)
            self.count += 1
            self.unreached += not reached
        return self._goal


def follow(
    arm: Workings,
    wishes: Iterable[Wish | None],
    speed: str,
    on_progress: Callable[[Progress], None] | None,
) -> FollowReport:
    """Follow a stream; see ``Arm.follow``."""
    follower = _Follower(arm, wishes, on_progress)
    started_s = arm.now_s()
    belongs = lead(arm, follower, speed, loaded=True)
    measured = arm.servos.measure() if belongs is None else settle(arm, belongs, speed)
    return FollowReport(
        wishes=follower.count,
        unreached=follower.unreached,
        refused=follower.refusals,
        reason=follower.reason,
        ended=follower.ended,
        measured_rad=dict(zip(arm.servos.names, measured.tolist(), strict=True)),
        measured_tip_m=arm.planner.tip(measured),
        duration_s=arm.now_s() - started_s,
    )
