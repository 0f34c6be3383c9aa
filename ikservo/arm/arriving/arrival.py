"""Arrival: joints are led to where they belong by what their sensors say is missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ikservo.arm.arriving.aim import Aim
from ikservo.arm.arriving.correction import Correction
from ikservo.arm.streaming.beat import Beat
from ikservo.arm.streaming.servos import Servos
from ikservo.arm.streaming.stream import Stream
from ikservo.errors import NotSettledError
from ikservo.kinematics.se3 import Vector
from ikservo.motion import JointMove, Pace

__all__ = ["Arrival", "arrive"]


@dataclass(frozen=True, slots=True, eq=False)
class Arrival:
    """Where a motion ended.

    Attributes:
        measured: Where the joints are (n,), rad or m.
        short: Which joints did not arrive, by how much and why, in words.
        motion_s: How long the motion took up to its planned end.
        settling_s: How long it took from there until all joints stood where they belong.
    """

    measured: Vector
    short: tuple[str, ...]
    motion_s: float
    settling_s: float

    @property
    def duration_s(self) -> float:
        """Return the time from the first goal to rest."""
        return self.motion_s + self.settling_s


def arrive(
    stream: Stream,
    servos: Servos,
    aim: Aim,
    paces: Sequence[Pace],
    speed_rad_s: float,
    motion_s: float,
    below: Vector | None = None,
) -> Arrival:
    """Lead the goals until the joints stand where they are wanted, as near as they can.

    Where a joint can go no further the others make up for it, once.

    Args:
        stream: The way to the servos.
        servos: The arm, at the end of its motion.
        aim: Where the joints belong.
        paces: How fast each may go.
        speed_rad_s: The motion's top speed at the horns.
        motion_s: How long the motion took up to here.
        below: Goals (n,) to which joints with known play go first, see ``drawn_back``.

    Raises:
        NotSettledError: Some joint still moves after three seconds.
        StoppedError, RefusedError, BusError, ServoAlarmError: See ``Stream.run``.
    """
    started_s = servos.clock.now_s()
    if below is not None:
        stream.run(JointMove(servos.goals(), below, paces), speed_rad_s=speed_rad_s)
    first = last = _led(stream, servos, aim.ticks, paces, speed_rad_s)
    instead = aim.without(first.held, first.measured) if first.held else None
    if instead is not None:
        last = _led(stream, servos, instead, paces, speed_rad_s)
    settling_s = servos.clock.now_s() - started_s
    short = tuple(dict.fromkeys(first.short + last.short))
    return Arrival(last.measured, short, motion_s, settling_s)


def _led(
    stream: Stream,
    servos: Servos,
    wanted: Sequence[int | None],
    paces: Sequence[Pace],
    speed_rad_s: float,
) -> Correction:
    goals = [f.tick(float(goal)) for f, goal in zip(servos.fences, servos.goals(), strict=True)]
    course = Correction(servos.fences, goals, wanted, paces)

    def look(beat: Beat) -> None:
        course.see(beat.time_s, beat.measured)

    stream.run(course, look, speed_rad_s=speed_rad_s)
    if course.moving:
        names = ", ".join(course.moving)
        raise NotSettledError(
            f"{names} did not settle in time.", "Check for a loose horn or a changing load."
        )
    return course
