"""A motion that could start now, and what there is to know about it before it does."""

from __future__ import annotations

from dataclasses import dataclass

from ikservo.ik import Result
from ikservo.kinematics.se3 import Vector
from ikservo.motion import Course

__all__ = ["NearLimit", "Plan"]


@dataclass(frozen=True, slots=True)
class NearLimit:
    """A joint that comes close to one of its limits on the way.

    Attributes:
        joint: Its name.
        side: ``lower`` or ``upper``.
        room: How far inside the limit it stays, rad or m.
        unit: ``rad`` or ``m``.
    """

    joint: str
    side: str
    room: float
    unit: str


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A motion that could start now.

    Attributes:
        start: Where all joints would begin (n,), rad or m.
        goal: Where all joints would end (n,).
        course: What they would do in between; what was checked is what is streamed.
        tip_m: Where the goal puts the tip (3,), metres.
        path_m: The way of the tip.
        duration_s: How long it takes.
        speed: slow, normal or fast.
        setters: The joints that set the time, at their top speed or acceleration, in words.
        near: The joints that come close to a limit on the way, the closest first.
        target_m: The point it goes to (3,); None for a motion of joints.
        solution: What the solver answered; None for a motion of joints.
        left_rad: How far the tool will be from how it should stand, at worst.
        slowed: Whether it goes slower than asked, for it is the first after torque comes on.
        straight: Whether the tip goes along straight lines.
        by: The pose by way of which it goes; empty where it goes straight.
    """

    start: Vector
    goal: Vector
    course: Course
    tip_m: Vector
    path_m: float
    duration_s: float
    speed: str
    setters: tuple[str, ...] = ()
    near: tuple[NearLimit, ...] = ()
    target_m: Vector | None = None
    solution: Result | None = None
    left_rad: float = 0.0
    slowed: bool = False
    straight: bool = False
    by: str = ""
