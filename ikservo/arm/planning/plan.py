"""A motion that could start now, and what there is to know about it before it does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ikservo.arm.given import number
from ikservo.arm.trajectory import Trajectory, sampled
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
        orientation_requested: Whether an orientation of the tool was requested.
        slowed: Whether it goes slower than asked, for it is the first after torque comes on.
        straight: Whether the tip goes along straight lines.
        by: The pose by way of which it goes; empty where it goes straight.
        names: The joints, in the order of ``start`` and ``goal``.
        units: ``rad`` or ``m`` for each joint.
        again: Makes the same plan from where the arm is when it is called, None for another arm
            than it was made for; set where the arm was limp, for such an arm may sink until its
            torque comes on.
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
    orientation_requested: bool = False
    slowed: bool = False
    straight: bool = False
    by: str = ""
    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    again: Callable[[object], Plan | None] | None = None

    def sample(self, dt_s: float = 0.01) -> Trajectory:
        """Return the motion as arrays: times (k,), positions and velocities (k, n).

        Args:
            dt_s: Between two samples; the last is at the motion's end.

        Raises:
            BadValueError: ``dt_s`` is not above 0, or makes more than a million samples.
        """
        dt_s = number("The time between two samples", dt_s)
        return sampled(self.course, dt_s, self.names, self.units)

    def to_csv(
        self, path: Path | str | None = None, dt_s: float = 0.01, *, overwrite: bool = False
    ) -> str:
        """Return the sampled motion as CSV, and write it to a file where a path is given.

        Raises:
            BadValueError: See ``sample``; or the file exists and ``overwrite`` is false.
            FileWriteError: It cannot be written.
        """
        return self.sample(dt_s).to_csv(path, overwrite=overwrite)

    def __repr__(self) -> str:
        """Return where it goes, how far and how long."""
        ends = zip(self.names, self.goal.tolist(), strict=True)
        goal = ", ".join(f"{name}: {at:.4f}" for name, at in ends)
        return (
            f"Plan({self.duration_s:.2f} s, {self.speed}, tip {self.path_m:.3f} m to "
            f"({', '.join(f'{x:z.3f}' for x in self.tip_m)}), goal={{{goal}}})"
        )
