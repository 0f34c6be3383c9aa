"""Synthetic hands: smooth motions with tremor and noise of a tracker, and their errors."""

import math
from dataclasses import dataclass, field

import numpy as np

from ikservo.apps.teleoperating.pose_filter import TrackedPose
from ikservo.kinematics.se3 import exp_so3, make_pose

AWAY_M = np.array([4.0, -2.0, 1.3])  # the origin of the tracker is anywhere
AWAY_RAD = np.array([0.4, -1.1, 2.0])


@dataclass
class Hand:
    """A hand that moves along a sum of sines.

    Attributes:
        seed: The seed of the motion.
        span_m: The largest displacement along an axis.
        span_rad: The largest rotation about an axis.
        fastest_hz: The highest frequency of the motion.
        noise_m: The standard deviation of the tracker.
        noise_rad: The same for angles.
    """

    seed: int
    span_m: float = 0.04
    span_rad: float = 0.3
    fastest_hz: float = 0.4
    noise_m: float = 0.0
    noise_rad: float = 0.0
    random: np.random.Generator = field(init=False)

    def __post_init__(self):
        self.random = np.random.default_rng(self.seed)
        self._hz = self.random.uniform(0.3, 1.0, (3, 6)) * self.fastest_hz
        self._phase = self.random.uniform(0.0, math.tau, (3, 6))
        self._size = np.array([self.span_m] * 3 + [self.span_rad] * 3) / 3.0

    def state(self, time_s):
        """Return displacement and rotation vector (6,) at a time."""
        return self._size * np.sin(math.tau * self._hz * time_s + self._phase).sum(axis=0)

    def pose(self, time_s, scale=1.0):
        """Return the pose (4, 4) that the tracker measures."""
        state = self.state(time_s) * scale
        noise = self.random.normal(size=6) * np.repeat([self.noise_m, self.noise_rad], 3)
        moved = state + noise
        return make_pose(AWAY_M + moved[:3], exp_so3(moved[3:]) @ exp_so3(AWAY_RAD))

    def tracked(self, time_s, *, held=True):
        return TrackedPose(self.pose(time_s), held)


def sampled(clock, rate_hz, duration_s, tracked):
    """Yield a hand's poses at a rate, once each, and None in the cycles between them.

    Args:
        clock: The clock of the arm.
        rate_hz: The rate of the tracker.
        duration_s: The time until the end.
        tracked: Returns the item for a time since the start.
    """
    start_s, count = clock.now_s(), -1
    while (elapsed_s := clock.now_s() - start_s) < duration_s:
        if int(elapsed_s * rate_hz) == count:
            yield None
        else:
            count = int(elapsed_s * rate_hz)
            yield tracked(count / rate_hz)
