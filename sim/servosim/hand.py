"""A person's hand on a joint: it holds, guides, sweeps or pushes with a limited force."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

Path = Callable[[float], tuple[float, float]]  # seconds since the grasp -> position, velocity

HAND_SPEED = 1.0  # rad/s, or m/s / 10 on a sliding joint: how fast a hand leads a joint
STIFFNESS_RAD_S = 150.0  # natural frequency of the grip; stable at steps of 2 ms


def hold(position: float) -> Path:
    """Stay at a position (rad, or m for a sliding joint)."""
    return lambda _: (position, 0.0)


def push(direction: float) -> Path:
    """Push with the hand's whole force towards the sign of `direction`, wherever the joint is."""
    return hold(math.copysign(math.inf, direction))


def glide(start: float, end: float, speed: float) -> Path:
    """Move from `start` to `end` at a constant speed and stay there."""
    duration_s = abs(end - start) / speed
    velocity = math.copysign(speed, end - start)

    def path(time_s: float) -> tuple[float, float]:
        if time_s >= duration_s:
            return end, 0.0
        return start + velocity * time_s, velocity

    return path


def sweep(start: float, lower: float, upper: float, speed: float) -> Path:
    """Move back and forth between two positions for ever, upwards first."""
    span = upper - lower

    def path(time_s: float) -> tuple[float, float]:
        phase = (start - lower + speed * time_s) % (2.0 * span)
        if phase < span:
            return lower + phase, speed
        return upper - (phase - span), -speed

    return path


@dataclass(slots=True)
class Hand:
    """A grip on one joint: a critically damped spring that follows a path.

    Attributes:
        path: Where the hand wants to be.
        limit: Its greatest force: N m, or N on a sliding joint.
        only: +1 or -1 for one that lies there and pushes only that way: an obstacle. 0 for a grip.
        force: What it pressed with in the last step; positive forward.
        time_s: Since the grasp.
    """

    path: Path
    limit: float = 2.0
    only: int = 0
    force: float = field(default=0.0, init=False)
    time_s: float = field(default=0.0, init=False)

    def press(self, dt_s: float, position: float, velocity: float, inertia: float) -> float:
        """The force on the joint for the next `dt_s` seconds."""
        self.time_s += dt_s
        goal, goal_velocity = self.path(self.time_s)
        wanted = STIFFNESS_RAD_S * (goal - position) + 2.0 * (goal_velocity - velocity)
        wanted *= STIFFNESS_RAD_S * inertia
        if self.only and (goal - position) * self.only <= 0.0:
            wanted = 0.0  # the joint has not come to it
        self.force = min(self.limit, max(-self.limit, wanted))
        return self.force
