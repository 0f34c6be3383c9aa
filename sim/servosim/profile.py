"""The path that a servo's firmware draws towards a goal: pieces of constant acceleration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple


class Piece(NamedTuple):
    """A stretch of time with constant acceleration."""

    duration_s: float
    velocity_rad_s: float  # at its start
    acceleration_rad_s2: float


def trapezoid(
    distance_rad: float, velocity_rad_s: float, limit_rad_s: float, acceleration_rad_s2: float
) -> list[Piece]:
    """From the present velocity to rest at a distance, as fast as the limits allow.

    The velocity is continuous whatever it was when the goal changed: a goal too near to stop at
    is overrun and come back to. Both sides of the trapezoid have the same slope (Dynamixel
    e-manual, "Profile Velocity", Feetech "acceleration" and "goal speed").

    Args:
        distance_rad: Signed way to the goal.
        velocity_rad_s: Present velocity.
        limit_rad_s: Cruising speed; 0 = none.
        acceleration_rad_s2: Slope of both ramps; 0 = none: the velocity jumps.

    Returns:
        The pieces; none when the goal is to be jumped to.
    """
    if acceleration_rad_s2 <= 0.0:
        return _rectangle(distance_rad, limit_rad_s)
    stop_rad = velocity_rad_s * abs(velocity_rad_s) / (2.0 * acceleration_rad_s2)
    sign = math.copysign(1.0, distance_rad - stop_rad)
    forward_rad, speed_rad_s = sign * distance_rad, sign * velocity_rad_s
    peak_rad_s = math.sqrt(max(0.0, acceleration_rad_s2 * forward_rad + speed_rad_s**2 / 2.0))
    top_rad_s = min(peak_rad_s, limit_rad_s) if limit_rad_s > 0.0 else peak_rad_s
    ramp_s = abs(top_rad_s - speed_rad_s) / acceleration_rad_s2
    brake_s = top_rad_s / acceleration_rad_s2
    ramps_rad = (speed_rad_s + top_rad_s) / 2.0 * ramp_s + top_rad_s / 2.0 * brake_s
    cruise_s = max(0.0, forward_rad - ramps_rad) / top_rad_s if top_rad_s > 0.0 else 0.0
    slope = math.copysign(acceleration_rad_s2, top_rad_s - speed_rad_s)
    return [
        Piece(ramp_s, velocity_rad_s, sign * slope),
        Piece(cruise_s, sign * top_rad_s, 0.0),
        Piece(brake_s, sign * top_rad_s, -sign * acceleration_rad_s2),
    ]


def timed(distance_rad: float, velocity_rad_s: float, total_s: float, ramp_s: float) -> list[Piece]:
    """From the present velocity to rest at a distance, in a given time.

    Dynamixel's time-based profile (drive mode bit 2): Profile Velocity is the whole time,
    Profile Acceleration each ramp, cut to half of the whole. Feetech's goal time has no ramps.
    """
    ramp_s = min(ramp_s, total_s / 2.0)
    if ramp_s <= 0.0:
        return [Piece(total_s, distance_rad / total_s, 0.0)]
    cruise_rad_s = (distance_rad - velocity_rad_s * ramp_s / 2.0) / (total_s - ramp_s)
    return [
        Piece(ramp_s, velocity_rad_s, (cruise_rad_s - velocity_rad_s) / ramp_s),
        Piece(total_s - 2.0 * ramp_s, cruise_rad_s, 0.0),
        Piece(ramp_s, cruise_rad_s, -cruise_rad_s / ramp_s),
    ]


def ramp(velocity_rad_s: float, goal_rad_s: float, acceleration_rad_s2: float) -> list[Piece]:
    """From one velocity to another; none when it is to be jumped to."""
    if acceleration_rad_s2 <= 0.0 or goal_rad_s == velocity_rad_s:
        return []
    slope = math.copysign(acceleration_rad_s2, goal_rad_s - velocity_rad_s)
    return [Piece((goal_rad_s - velocity_rad_s) / slope, velocity_rad_s, slope)]


def _rectangle(distance_rad: float, limit_rad_s: float) -> list[Piece]:
    if limit_rad_s <= 0.0 or distance_rad == 0.0:
        return []
    return [Piece(abs(distance_rad) / limit_rad_s, math.copysign(limit_rad_s, distance_rad), 0.0)]


class Reference:
    """A point that travels along a profile; exact at any step length."""

    __slots__ = (
        "_elapsed_s", "_end_rad", "_end_rad_s", "_pieces", "_start_rad",
        "acceleration_rad_s2", "position_rad", "running", "velocity_rad_s",
    )  # fmt: skip

    def __init__(self, position_rad: float) -> None:
        self._pieces: list[Piece] = []
        self._elapsed_s = 0.0
        self._start_rad = self._end_rad = self.position_rad = position_rad
        self._end_rad_s = self.velocity_rad_s = self.acceleration_rad_s2 = 0.0
        self.running = False

    def put(self, position_rad: float, velocity_rad_s: float = 0.0) -> None:
        """Forget the profile and stand at a place."""
        self.position_rad = position_rad
        self.follow((), position_rad, velocity_rad_s)

    def follow(self, pieces: Sequence[Piece], end_rad: float, end_rad_s: float = 0.0) -> None:
        """Travel along `pieces` from here, and end exactly at a place with a velocity."""
        self._pieces = [piece for piece in reversed(pieces) if piece.duration_s > 0.0]
        self._end_rad, self._end_rad_s = end_rad, end_rad_s
        self._begin()

    def advance(self, dt_s: float) -> None:
        """Travel for `dt_s` seconds."""
        elapsed_s = self._elapsed_s + dt_s
        while self.running and elapsed_s >= self._pieces[-1].duration_s:
            elapsed_s -= self._end_piece()
        if not self.running:
            return
        _, velocity_rad_s, acceleration_rad_s2 = self._pieces[-1]
        gained_rad_s = acceleration_rad_s2 * elapsed_s
        self._elapsed_s = elapsed_s
        self.velocity_rad_s = velocity_rad_s + gained_rad_s
        self.position_rad = self._start_rad + (velocity_rad_s + gained_rad_s / 2.0) * elapsed_s

    def _end_piece(self) -> float:
        duration_s, velocity_rad_s, acceleration_rad_s2 = self._pieces.pop()
        mean_rad_s = velocity_rad_s + acceleration_rad_s2 * duration_s / 2.0
        self.position_rad = self._start_rad + mean_rad_s * duration_s
        self._begin()
        return duration_s

    def _begin(self) -> None:
        self._elapsed_s = 0.0
        self.running = bool(self._pieces)
        if self.running:
            self._start_rad = self.position_rad
            _, self.velocity_rad_s, self.acceleration_rad_s2 = self._pieces[-1]
        else:
            self.position_rad, self.velocity_rad_s = self._end_rad, self._end_rad_s
            self.acceleration_rad_s2 = 0.0
