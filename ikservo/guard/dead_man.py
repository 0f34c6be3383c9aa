"""The dead man's switch: commands that stop coming are a stop."""

from __future__ import annotations

import math

__all__ = ["DEAD_MAN_TIMEOUT_S", "DeadMan"]

DEAD_MAN_TIMEOUT_S = 0.3
"""How long one command lasts, of whoever streams them: without another the arm brakes and holds."""


class DeadMan:
    """Tells whether the last command from outside is too old to move on.

    Args:
        timeout_s: How long one command lasts.
    """

    def __init__(self, timeout_s: float = DEAD_MAN_TIMEOUT_S) -> None:
        self._timeout_s = timeout_s
        self._fresh_s = -math.inf

    def fresh(self, time_s: float) -> None:
        """Note that a command came; one with no time, or an older one, does not count."""
        if time_s < math.inf:
            self._fresh_s = max(self._fresh_s, time_s)

    def check(self, time_s: float) -> bool:
        """Return whether the switch has expired; it has as long as no command ever came."""
        return not time_s - self._fresh_s <= self._timeout_s
