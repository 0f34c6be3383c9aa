"""Dead-man switch: a streamed command is valid only for a short time."""

from __future__ import annotations

import math

DEAD_MAN_TIMEOUT_S = 0.3
"""Time for which a streamed command is valid [s]; after that, the arm brakes and holds."""


class DeadManSwitch:
    """Check of whether the last command from a client is too old to continue a motion."""

    def __init__(self, timeout_s: float = DEAD_MAN_TIMEOUT_S) -> None:
        self._timeout_s = timeout_s
        self._fresh_s = -math.inf

    def refresh(self, time_s: float) -> None:
        """Record a command, unless it has no time stamp or is older than the last command."""
        if time_s < math.inf:
            self._fresh_s = max(self._fresh_s, time_s)

    def postpone(self, delay_s: float) -> None:
        """Exclude the time of a program delay, in which no command could arrive."""
        self._fresh_s += delay_s

    def expired(self, time_s: float) -> bool:
        """Check whether the switch has expired; it counts as expired until the first command."""
        return not time_s - self._fresh_s <= self._timeout_s
