"""Where an arm's zeros come from, and what it may do while they are not calibrated."""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import Enum

from ikservo.errors import CalibrationError
from ikservo.kinematics.arrays import Vector

__all__ = ["MAX_UNCALIBRATED_STEP_RAD", "ZeroSource"]

MAX_UNCALIBRATED_STEP_RAD = math.radians(10.0)
"""How far a joint whose zero nobody knows may be moved at once, as its horn turns."""

_HINT = (
    "Calibrate it: ikservo calibrate {arm}. Until then: ikservo joints, at most 10° at a time "
    "(or --uncalibrated, if the horns are mounted exactly as in the arm file)."
)


class ZeroSource(Enum):
    """Whose the zeros of an arm's joints are."""

    CALIBRATED = "this arm's own"
    VENDOR = "the maker's"
    SIMULATED = "the simulator's"
    ACCEPTED = "the arm file's, as the person said"
    UNKNOWN = "the arm file's"

    @property
    def are_known(self) -> bool:
        """Return whether positions mean what they say."""
        return self is not ZeroSource.UNKNOWN

    def require_known(self, arm: str) -> None:
        """Refuse what needs to know where the arm is.

        Raises:
            CalibrationError: The arm is not calibrated.
        """
        if not self.are_known:
            raise CalibrationError(f"{arm} is not calibrated.", _HINT.format(arm=arm))

    def check_small_steps(
        self, arm: str, here: Vector, goal: Vector, steps: Mapping[str, float]
    ) -> None:
        """Refuse long ways of single joints where zeros are unknown.

        Args:
            arm: Its name.
            here: Where the joints are (n,), rad or m.
            goal: Where they shall go (n,).
            steps: The longest way for each joint, in the order of the vectors.

        Raises:
            CalibrationError: A joint would go further.
        """
        if self.are_known:
            return
        for (name, step), way in zip(steps.items(), abs(goal - here), strict=True):
            if way > step * (1.0 + 1e-6):
                raise CalibrationError(
                    f"{arm} is not calibrated, and {name} would move by more than 10°.",
                    _HINT.format(arm=arm),
                )
