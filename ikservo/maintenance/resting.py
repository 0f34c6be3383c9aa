"""Where a limp arm comes to rest: found by letting the simulated arm sink."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ikservo.arm.opening import open_arm

__all__ = ["RestingPlace", "find_resting_place"]

_STEP_S, _MIN_S, _MAX_S = 1.0, 4.0, 60.0
_STILL = 0.001  # rad or m, in a step


@dataclass(frozen=True, slots=True)
class RestingPlace:
    """Where an arm comes to rest.

    Attributes:
        positions: By joint, rad or m.
        sank_s: How long it took.
        gap_m: The smallest distance of its body there, as the guard measures it; negative where
            its shapes overlap.
        still: Whether it came to rest.
    """

    positions: dict[str, float]
    sank_s: float
    gap_m: float
    still: bool


def find_resting_place(folder: Path, pose: str = "home") -> RestingPlace:
    """Simulate an arm that is released in a pose, until it lies still or a minute is over.

    Args:
        folder: The arm's.
        pose: The pose in which it is released.

    Raises:
        IkservoError: The arm cannot be simulated.
    """
    with open_arm(folder, f"sim:?pose={pose}", uncalibrated=True) as arm:
        limits = {joint.name: joint.limits for joint in arm.model.joints}
        before = arm.where().positions
        sank_s, still = 0.0, False
        while sank_s < _MAX_S and not (still and sank_s >= _MIN_S):
            arm.clock.sleep_until(arm.clock.now_s() + _STEP_S)
            sank_s += _STEP_S
            now = arm.where().positions
            still = max(abs(now[name] - before[name]) for name in now) < _STILL
            before = now
        inside = {
            name: float(np.clip(at, limits[name].lower.value, limits[name].upper.value))
            for name, at in before.items()
        }
        return RestingPlace(inside, sank_s, arm.clearance_m(inside), still)
