"""What a servo of an arm may be asked to bear."""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["HealthLimits"]


@dataclass(frozen=True, slots=True)
class HealthLimits:
    """When to warn, to hold and to let go; ``[health]`` of the arm file.

    Attributes:
        warn_c: From this temperature on a person is told.
        hold_c: From this one on the arm holds and takes no more goals.
        release_c: From this one on it goes to rest, where it can, and lets go.
        load_percent: A load above this share of the most there is ...
        load_s: ... for this long is an overload.
        low_v: The least supply, besides the servo's own limit.
        high_v: The highest, likewise.
    """

    warn_c: float = 60.0
    hold_c: float = 65.0
    release_c: float = 70.0
    load_percent: float = 90.0
    load_s: float = 3.0
    low_v: float = 0.0
    high_v: float = math.inf
