"""Finds a joint that swings in the play of its gears, and brings it to rest."""

from __future__ import annotations

import math

__all__ = ["SwingDamper"]

# A joint that turns round so often, by more than noise explains, swings in the play of its gears.
# Turns by what stiction explains, while it is corrected, count by this share.
_NOISE_TICKS, _MIN_TURNS, _STICTION_TICKS, _SHARE_OF_STICTION = 2, 2.0, 4, 0.34
# The goal of one that swings goes along with it by this share, which comes within this time, and by
# no more than the last number: docs/decisions/0020 says why a servo so soft comes to rest.
_SHARE, _SOFTEN_S, _MAX_TICKS = 0.75, 0.1, 20.0
# A joint that swings stays for a while where it turns round, and its rotor takes as long to cross
# the play after the goal has moved: it rests when neither has moved for so long.
_AT_REST_S = 0.3
# One that swings for so long nevertheless is left swinging.
_MAX_SWING_S = 2.0


class SwingDamper:
    """Counts how often a joint turns round, and softens its servo by its goals while it swings.

    Attributes:
        ticks: How far the joint went between the last two times that it turned round.
        rests: How often a swing came to rest.
        steady_s: For how long the joint has not been corrected.
    """

    def __init__(self) -> None:
        self.ticks = self.rests = 0
        self._at = self._turn = self._extreme = self._heading = 0
        self._turns = 0.0
        self._has_begun = self._has_turned = False
        self._since_s, self._middle, self._share, self.steady_s = math.inf, 0.0, 0.0, 0.0

    @property
    def swings(self) -> bool:
        """Whether the joint swings, or has done so too often to be corrected again."""
        return self._turns >= _MIN_TURNS

    @property
    def goal_ticks(self) -> float:
        """By how much the goal goes along with the swing."""
        along = _SHARE * self._share * (self._at - self._middle)
        return min(max(along, -_MAX_TICKS), _MAX_TICKS)

    def update(self, tick: int, time_s: float, elapsed_s: float, *, goal_moves: bool) -> None:
        """Take the measured position of one cycle.

        Args:
            tick: The position.
            time_s: When it was measured.
            elapsed_s: Since the last one.
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
        """Count a turn after which the joint has come to a tick."""
        self._has_turned = True
        self.ticks = abs(self._extreme - self._turn)
        is_sure = self.steady_s > _AT_REST_S or self.ticks > _STICTION_TICKS
        if self._heading:
            self._turns += 1.0 if is_sure else _SHARE_OF_STICTION
        self._turn, self._extreme = self._extreme, tick
        self._heading = 1 if tick > self._turn else -1

    def may_swing(self, still_s: float) -> bool:
        """Check whether a joint that does not move may just turn round.

        Args:
            still_s: For how long it has not moved.
        """
        return self._has_turned and min(still_s, self.steady_s) < _AT_REST_S

    def has_swung_at(self, time_s: float) -> bool:
        """Check whether the joint has swung for so long that it is left swinging."""
        return time_s - self._since_s >= _MAX_SWING_S

    def rest(self) -> None:
        """Forget the swing: it has come to rest, and the joint is corrected again."""
        self.rests += 1
        self._turn = self._extreme = self._at
        self._turns = self._share = 0.0
        self._heading = 0
