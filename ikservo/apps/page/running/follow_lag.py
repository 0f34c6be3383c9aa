"""Lag of a follower behind its leader, in time and in the positions of its joints."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass

import numpy as np

from ikservo.kinematics.arrays import Vector

MAX_LAG_S = 0.5
"""Longest lag that is measured, seconds."""

_WINDOW_S = 2.0
_STEP_S = 0.002
_LEAST_TRAVEL = 0.03  # rad or m; smaller motions do not determine a lag


@dataclass(frozen=True, slots=True)
class FollowLag:
    """The lag of a follower.

    Attributes:
        goal_s: Time by which the follower's setpoints lag behind the leader; None while the
            leader is still.
        arm_s: Time by which the follower's joints lag behind the leader; None while the leader
            is still.
        error: The largest present difference between a joint and the leader's joint, rad or m.
        joint: The joint with that error.
    """

    goal_s: float | None
    arm_s: float | None
    error: float
    joint: str


class LagMeter:
    """Comparison of the motions of a leader, its follower's setpoints and the follower's joints.

    Args:
        names: The joints that both arms have, in the order used in all arrays.
    """

    def __init__(self, names: tuple[str, ...]) -> None:
        self._names = names
        self._lock = threading.Lock()
        self._led: deque[tuple[float, Vector]] = deque()
        self._followed: deque[tuple[float, Vector, Vector]] = deque()

    def record(
        self, led_s: float, led: Vector, now_s: float, setpoints: Vector, measured: Vector
    ) -> None:
        """Add a sample of the leader (k,), measured at ``led_s``, and of the follower (k,) now."""
        with self._lock:
            if not self._led or led_s > self._led[-1][0]:
                self._led.append((led_s, led))
            self._followed.append((now_s, setpoints, measured))
            while now_s - self._followed[0][0] > _WINDOW_S:
                self._followed.popleft()
            while now_s - self._led[0][0] > _WINDOW_S + MAX_LAG_S:
                self._led.popleft()

    def read(self) -> FollowLag | None:
        """Compute the lag of the follower; None before the first samples."""
        with self._lock:
            led, followed = list(self._led), list(self._followed)
        if not led:
            return None
        gaps = np.abs(followed[-1][2] - led[-1][1])
        worst = int(gaps.argmax())
        goal_s, arm_s = _find_lags(led, followed)
        return FollowLag(goal_s, arm_s, float(gaps[worst]), self._names[worst])


def _find_lags(
    led: list[tuple[float, Vector]], followed: list[tuple[float, Vector, Vector]]
) -> tuple[float | None, float | None]:
    """Estimate the lags of setpoints and positions, using the joint with the most travel."""
    led_s = np.array([sample[0] for sample in led])
    positions = np.array([sample[1] for sample in led])
    travel = np.ptp(positions, axis=0)
    joint = int(travel.argmax())
    # Use only the part of the follower's samples that the leader's samples precede.
    since_s = led_s[0] + MAX_LAG_S
    followed = [sample for sample in followed if sample[0] >= since_s]
    if travel[joint] < _LEAST_TRAVEL or not followed:
        return None, None
    now_s = np.array([sample[0] for sample in followed])
    setpoints = np.array([sample[1][joint] for sample in followed])
    measured = np.array([sample[2][joint] for sample in followed])
    leader = positions[:, joint]
    return _lag_s(led_s, leader, now_s, setpoints), _lag_s(led_s, leader, now_s, measured)


def _lag_s(led_s: Vector, led: Vector, now_s: Vector, followed: Vector) -> float:
    """Compute the time shift [s] that fits best: least squares over a grid of shifts."""
    shifts_s = np.arange(0.0, MAX_LAG_S + _STEP_S / 2, _STEP_S)
    errors = [float(np.sum((np.interp(now_s - shift, led_s, led) - followed) ** 2))
              for shift in shifts_s]  # fmt: skip
    return float(min(shifts_s[int(np.argmin(errors))], MAX_LAG_S))
