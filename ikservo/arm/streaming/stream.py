"""Goals at a steady beat: any course of joints, watched, throttled and stopped."""

from __future__ import annotations

from collections.abc import Callable

from ikservo.arm.streaming.beat import Beat
from ikservo.arm.streaming.halt import StopReason
from ikservo.arm.streaming.servos import Servos
from ikservo.arm.streaming.setpoints import Setpoints
from ikservo.arm.streaming.throttle import Throttle
from ikservo.kinematics.se3 import Vector
from ikservo.motion import Course, Metronome

__all__ = ["OnBeat", "Stream"]

OnBeat = Callable[[Beat], None]
"""Called at each beat; may re-aim the course or ask for a stop."""


class Stream:
    """Streams courses to the servos of one arm.

    Args:
        servos: The arm, its torque on.
        cycle_time_s: Between two goals; what the bus allows, as measured, if None.
    """

    def __init__(self, servos: Servos, cycle_time_s: float | None = None) -> None:
        self._servos, self._given_cycle_time_s = servos, cycle_time_s
        self._beat: Beat | None = None

    @property
    def cycle_time_s(self) -> float:
        """The time between two goals, seconds.

        Raises:
            RefusedError: None was given, and that of the bus was not measured yet.
        """
        return self._given_cycle_time_s or self._servos.cycle_time_s

    @property
    def beat(self) -> Beat | None:
        """Return the last beat of the running motion, or of the last one."""
        return self._beat

    def request_stop(self, reason: StopReason) -> None:
        """Let the running motion brake and end with ``StoppedError``; safe from anywhere.

        A signal, another thread or a callback may call it. The stop stays until acknowledged; where
        nothing moves, it keeps the next motion from beginning.
        """
        self._servos.request_stop(reason)

    def run(
        self, course: Course, on_beat: OnBeat | None = None, *, speed_rad_s: float | None = None
    ) -> Vector:
        """Carry a course out to its end.

        Args:
            course: What the joints shall do; it begins where their goals are now.
            on_beat: Called at each beat.
            speed_rad_s: The top speed of the motion at the horns, which is what the servos are
                limited to; the arm's fastest if None.

        Returns:
            Where the joints were (n,) at the last beat, rad or m.

        Raises:
            StoppedError: Somebody asked for a stop; the arm was braked and holds.
            ServoSilentError: A joint gave no answer for three beats in a row; the others hold.
            ServoAlarmError: A servo is not well, or was reset; the arm holds.
            RefusedError: The guard stopped it, or a joint does not follow; the arm holds.
            PortLostError: The line is gone.
        """
        with self._servos.streaming(speed_rad_s):
            return self._stream(course, on_beat)

    def _stream(self, course: Course, on_beat: OnBeat | None) -> Vector:
        servos, throttle, setpoints = self._servos, Throttle(self.cycle_time_s), Setpoints(course)
        told_s, there, restarts = servos.clock.now_s(), True, servos.restarts
        for _ in Metronome(servos.clock, self.cycle_time_s):
            measured = servos.beat()
            if servos.restarts > restarts:
                restarts = servos.restarts
                setpoints.lead_back(servos.goals())
            # One reading of the clock for the setpoint and for the guard that judges its step.
            now_s, before_s = servos.clock.now_s(), told_s
            gap_s = throttle.step(now_s - before_s, braking=bool(servos.stop_request))
            told_s = now_s
            setpoint = setpoints.next(servos.advance_s(gap_s) if there else 0.0)
            there = servos.command(setpoint, now_s)
            self._beat = self._told(setpoints.time_s, course.duration_s, measured, throttle.late_s)
            if on_beat:
                on_beat(self._beat)
            throttle.check()
            ended = there and setpoints.ended
            if ended or throttle.stands:
                servos.stop_request.raise_if_set()
            if ended:
                return measured
        raise AssertionError("the metronome never ends")

    def _told(self, time_s: float, duration_s: float, measured: Vector, late_s: float) -> Beat:
        servos = self._servos
        now_s = min(time_s, duration_s)
        return Beat(now_s, duration_s, servos.goals(), measured, late_s, servos.lost)
