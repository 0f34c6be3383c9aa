"""Tool speed of a Cartesian motion: the requested speed, and the speed that joints allow."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ikservo.kinematics.arrays import Matrix
from ikservo.motion import Trajectory

_STEP_S = 0.005  # time between two samples; longer in motions of minutes, to limit planning time
_MIN_SAMPLES = 200  # fewest samples of a motion
_MAX_SAMPLES = 20_000  # most samples of a motion
# Speeds that differ by less count as equal, because the tip slows down even at slight corners.
_SAME = 0.02
_SHORT_OR_BENT = "acceleration and jerk of the joints on a path this short or curved"


@dataclass(frozen=True, slots=True)
class ToolSpeed:
    """The speed of the tip along a Cartesian path.

    Attributes:
        requested_m_s: The constant speed that was requested.
        top_m_s: The maximum speed of the motion.
        slowest_m_s: The minimum speed between the first and the last instant at the requested
            speed; the maximum speed if the requested speed is never reached.
        limited_by: The limit that keeps the tool from the requested speed.
    """

    requested_m_s: float
    top_m_s: float
    slowest_m_s: float
    limited_by: tuple[str, ...] = ()

    @property
    def is_constant(self) -> bool:
        """Whether the requested speed is kept everywhere except on the ramps at both ends."""
        return self.slowest_m_s >= (1.0 - _SAME) * self.requested_m_s

    def with_reasons(self, joints: tuple[str, ...], speed: str, cap_m_s: float) -> ToolSpeed:
        """Return the speed with the reasons that limit it, if it is lower than requested.

        ``joints`` are at their top speed or acceleration; ``cap_m_s`` is the top speed of the tip.
        """
        if self.is_constant:
            return self
        if self.requested_m_s > cap_m_s and self.top_m_s >= (1.0 - _SAME) * cap_m_s:
            joints = (f"the speed class {speed} allows {1000.0 * cap_m_s:.0f} mm/s",)
        return replace(self, limited_by=joints or (_SHORT_OR_BENT,))

    def __str__(self) -> str:
        """Describe the speed that was reached."""
        requested, top, slowest = (
            f"{1000.0 * speed:.1f} mm/s"
            for speed in (self.requested_m_s, self.top_m_s, self.slowest_m_s)
        )
        if self.is_constant:
            return f"{requested}, constant except for the ramps at both ends"
        why = f" ({', '.join(self.limited_by)})" if self.limited_by else ""
        if self.top_m_s < (1.0 - _SAME) * self.requested_m_s:
            return f"at most {top} instead of {requested}{why}"
        return f"{requested}, but only {slowest} at the slowest point of the path{why}"


def sample_times_s(trajectory: Trajectory) -> list[float]:
    """Return times [s], equally spaced over a trajectory, at which its speed is evaluated."""
    needed = 1 + math.ceil(trajectory.duration_s / _STEP_S)
    count = min(max(_MIN_SAMPLES, needed), _MAX_SAMPLES)
    return np.linspace(0.0, trajectory.duration_s, count).tolist()


def tool_speed_between(tips_m: Matrix, step_s: float, requested_m_s: float) -> ToolSpeed:
    """Compute the speed of a tip from rest to rest, from points (k, 3) [m] at equal time steps."""
    speeds = np.linalg.norm(np.diff(tips_m, axis=0), axis=1) / max(step_s, 1e-12)
    fast = np.flatnonzero(speeds >= (1.0 - _SAME) * requested_m_s)
    top = float(speeds.max(initial=0.0))
    slowest = float(speeds[fast[0] : fast[-1] + 1].min()) if len(fast) else top
    return ToolSpeed(requested_m_s, top, slowest)
