"""Find joints that swing in the backlash of their gears, and bring them to rest."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ikservo.control.loop import ControlCycle
from ikservo.control.reversal_counter import ReversalCounter
from ikservo.guard import DrivenJoint

# docs/how-control-works.md explains how these numbers were chosen. During motion, a joint swings if
# its error reverses repeatedly.
_MIN_MOTION_TURNS = 6  # fewest reversals
_MOTION_SWING_RAD = 0.012  # at the horn, smallest of these reversals
_MOTION_TURN_S = 0.4  # longest time between two of them

# A joint that reverses this often, by more than noise explains, swings in its backlash.
_MIN_TURNS = 2.0
_NOISE_TICKS = 2
# During correction, reversals that stiction explains count less.
_STICTION_TICKS = 4  # largest of these reversals
_SHARE_OF_STICTION = 0.5  # each of them counts as this fraction of a reversal
# The goal of a swinging joint moves along with it; docs/decisions/0020 says why such a soft servo
# comes to rest.
_SHARE = 0.75  # fraction of the joint motion
_SOFTEN_S = 0.1  # time in which this fraction is reached
_MAX_TICKS = 20.0  # limit of the motion of the goal
# A swinging joint stays for a while where it reverses, and its rotor takes as long to cross the
# backlash after the goal has moved: it rests when neither has moved for this time.
_AT_REST_S = 0.3
# A joint that still swings after this time is left swinging.
_MAX_SWING_S = 2.0


class SwingDamper:
    """Counter of a joint's reversals; while it swings, its goals soften its servo.

    Attributes:
        ticks: The distance between the last two reversals of the joint.
        rests: The number of swings that came to rest.
        steady_s: Time for which the joint has not been corrected.
    """

    def __init__(self) -> None:
        self.ticks = self.rests = 0
        self._at = self._turn = self._extreme = self._heading = 0
        self._turns = 0.0
        self._has_begun = self._has_turned = False
        self._since_s, self._middle, self._share, self.steady_s = math.inf, 0.0, 0.0, 0.0

    @property
    def swings(self) -> bool:
        """Whether the joint is swinging, or has swung too often to be corrected again."""
        return self._turns >= _MIN_TURNS

    @property
    def goal_ticks(self) -> float:
        """Displacement of the goal in phase with the swing."""
        along = _SHARE * self._share * (self._at - self._middle)
        return min(max(along, -_MAX_TICKS), _MAX_TICKS)

    def update(self, tick: int, time_s: float, elapsed_s: float, *, goal_moves: bool) -> None:
        """Process the measured position of one cycle.

        Args:
            tick: The position.
            time_s: Time of the measurement.
            elapsed_s: Time since the last measurement.
            goal_moves: Whether the joint is corrected.
        """
        if not self._has_begun:
            self._turn = self._extreme = tick
            self._has_begun = True
        self._at = tick
        self.steady_s = 0.0 if goal_moves else self.steady_s + elapsed_s
        if self._heading * (tick - self._extreme) > 0:
            self._extreme = tick
        elif abs(tick - self._extreme) > _NOISE_TICKS:
            self._turn_round(tick)
        if not self.swings:
            self._since_s = math.inf
        elif self._since_s == math.inf:
            self._since_s, self._share = time_s, 0.0
            self._middle = self._turn + 0.5 * self._heading * self.ticks
        else:
            self._share = min(self._share + elapsed_s / _SOFTEN_S, 1.0)

    def _turn_round(self, tick: int) -> None:
        """Count a reversal of the joint; ``tick`` is its first position in the new direction."""
        self._has_turned = True
        self.ticks = abs(self._extreme - self._turn)
        is_sure = self.steady_s > _AT_REST_S or self.ticks > _STICTION_TICKS
        if self._heading:
            self._turns += 1.0 if is_sure else _SHARE_OF_STICTION
        self._turn, self._extreme = self._extreme, tick
        self._heading = 1 if tick > self._turn else -1

    def may_swing(self, still_s: float) -> bool:
        """Check whether a joint that seems to be at rest may only be reversing its direction.

        Args:
            still_s: Time for which the joint has not moved.
        """
        return self._has_turned and min(still_s, self.steady_s) < _AT_REST_S

    def has_swung_at(self, time_s: float) -> bool:
        """Check whether the joint has swung for so long that settling no longer waits for it."""
        return time_s - self._since_s >= _MAX_SWING_S

    def rest(self) -> None:
        """Reset the counts of a swing when the joint rests and is corrected again."""
        self.rests += 1
        self._turn = self._extreme = self._at
        self._turns = self._share = 0.0
        self._heading = 0


class MotionSwings:
    """Detector of joints that swing inside their backlash in motion, where feedback has no effect.

    A lagging joint changes sides whenever its reference reverses. That is not a swing, so the count
    of its reversals then restarts.

    Args:
        driven_joints: The joints, in the order used in the control cycle.
    """

    def __init__(self, driven_joints: Sequence[DrivenJoint]) -> None:
        self._maps = [driven.joint_map for driven in driven_joints]
        per_horn = [each.unit_per_tick / each.horn_rad_per_tick for each in self._maps]
        self._names = np.array([driven.joint for driven in driven_joints])
        least = _MOTION_SWING_RAD * np.abs(per_horn)
        self._turns = ReversalCounter(least, _MOTION_TURN_S)
        self._reversals = ReversalCounter(least, math.inf)
        self._widest = np.zeros(len(self._maps))
        self._last_s = 0.0

    def record(self, cycle: ControlCycle) -> None:
        """Process the measurements of a control cycle."""
        elapsed_s, self._last_s = cycle.time_s - self._last_s, cycle.time_s
        fresh = ~np.isin(self._names, cycle.lost)
        turned = self._turns.update(cycle.measured - cycle.reference, elapsed_s, fresh=fresh)
        self._turns.count[self._reversals.update(cycle.reference, elapsed_s, fresh=True)] = 0
        swings = turned & (self._turns.count >= _MIN_MOTION_TURNS)
        self._widest = np.where(swings, np.maximum(self._widest, self._turns.width), self._widest)

    def notes(self) -> tuple[str, ...]:
        """Return a note about each joint that swung, with its amplitude."""
        found = zip(self._maps, self._widest.tolist(), strict=True)
        return tuple(
            f"{each.joint} swung by up to {each.format(width)} as it moved"
            for each, width in found
            if width
        )
