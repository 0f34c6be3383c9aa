"""The control loop: setpoints, pauses, cycle data, and slowing down where servos lag behind."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ikservo.control.servo_group import ServoGroup
from ikservo.errors import RefusedError
from ikservo.guard import StopReason
from ikservo.kinematics.arrays import Vector
from ikservo.motion import Rate, Trajectory

__all__ = ["BRAKE_S", "ControlCycle", "ControlLoop", "OnCycle", "SetpointSampler", "TimeScaler"]


BRAKE_S = 0.25
"""How long a motion takes from full speed to a stop, and from a stop to full speed."""

# After a gap like this nothing is made up for: the motion starts anew from where it stands.
_STALL_S = 0.1
# Up to this gap a late beat is made up for.
_MAX_STEP_S = 0.02
# A beat later than this counts; so many more late beats than good ones are too many.
_LATE_S, _LATE_CYCLES = 0.025, 50


class TimeScaler:
    """Turns the time of the clock into the time of a motion.

    A motion whose time passes slower stays on its path and inside every limit: this is how it is
    braked, and how it starts again after the program was held up.

    Args:
        beat_s: Between two goals when all is well.

    Attributes:
        rate: Seconds of the motion in one of the clock, 0 to 1.
        late_s: How much longer than its period the beat before took.
    """

    def __init__(self, beat_s: float) -> None:
        self._beat_s = beat_s
        self._late_beats = 0
        self.late_s = 0.0
        self.rate = 1.0

    @property
    def stopped(self) -> bool:
        """Return whether the motion has been braked to a stop."""
        return self.rate <= 0.0

    def step(self, elapsed_s: float, *, braking: bool) -> float:
        """Count one control cycle, adapt the rate to it, and say how far the motion goes on.

        Called once a cycle, before the lag of the joints is looked at.

        Args:
            elapsed_s: Since the cycle before, by the clock.
            braking: A stop is wanted.

        Returns:
            The time by which the motion may go on, seconds.
        """
        self._count_late_cycles(elapsed_s)
        gap_s = min(elapsed_s, max(_MAX_STEP_S, 2.0 * self._beat_s))
        if elapsed_s > _STALL_S:
            self.rate = 0.0
        elif braking or self._late_beats > _LATE_CYCLES:
            self.rate = max(0.0, self.rate - gap_s / BRAKE_S)
        else:
            self.rate = min(1.0, self.rate + gap_s / BRAKE_S)
        return self.rate * gap_s

    def raise_if_too_slow(self) -> None:
        """Raise once a machine that is too slow has braked the motion to a stop.

        Raises:
            RefusedError: It is.
        """
        if self._late_beats > _LATE_CYCLES and self.stopped:
            raise RefusedError(
                f"The computer is too busy for a control cycle of {self._beat_s * 1000:.1f} ms; "
                "the arm was slowed down and stopped.",
                "Reduce the computer's load, then move again.",
            )

    def _count_late_cycles(self, elapsed_s: float) -> None:
        self.late_s = max(0.0, elapsed_s - self._beat_s)
        late = self.late_s > _LATE_S
        self._late_beats = max(0, self._late_beats + (1 if late else -1))


@dataclass(frozen=True, slots=True, eq=False)
class ControlCycle:
    """What was told and heard at one beat.

    Attributes:
        time_s: Of the motion: the time of its course, not of the clock.
        duration_s: Of the whole motion; infinite for one that goes on until it is ended.
        goals: Where the servos were told to go (n,), rad or m.
        measured: Where the joints are (n,); of a joint in ``lost``, where it was last seen.
        late_s: How much longer than its period the beat before took.
        lost: Joints whose answer is missing.
    """

    time_s: float
    duration_s: float
    goals: Vector
    measured: Vector
    late_s: float = 0.0
    lost: tuple[str, ...] = ()


# Servos that stopped themselves stand a little behind the course: they are led back in this time.
_RETURN_S = 0.5


class SetpointSampler:
    """Turns the time that a motion may go on into positions of its course.

    After `restart_from` the course stands still, and setpoints go straight from where the joints
    were stopped to where the course is; then it goes on.

    Args:
        course: What the joints shall do.

    Attributes:
        time_s: Of the course.
    """

    def __init__(self, course: Trajectory) -> None:
        self._course = course
        self.time_s = 0.0
        self._start: Vector | None = None
        self._returned_s = 0.0

    @property
    def has_ended(self) -> bool:
        """Return whether the course is at its end."""
        return self._start is None and self.time_s >= self._course.duration_s

    def restart_from(self, here: Vector) -> None:
        """Begin at ``here`` (n,), rad or m: the servos were stopped there."""
        self._start, self._returned_s = here, 0.0

    def next_setpoint(self, gap_s: float) -> Vector:
        """Return the setpoint (n,), rad or m, after the motion has gone on by a time."""
        if self._start is None:
            self.time_s += gap_s
            return self._course.state(self.time_s).position
        self._returned_s += gap_s
        share = min(self._returned_s / _RETURN_S, 1.0)
        goal, start = self._course.state(self.time_s).position, self._start
        if share >= 1.0:
            self._start = None
        return start + share * (goal - start)


OnCycle = Callable[[ControlCycle], None]
"""Called at each beat; may re-aim the course or ask for a stop."""


class ControlLoop:
    """Streams courses to the servos of one arm.

    Args:
        servos: The arm, its torque on.
        cycle_time_s: Between two goals; what the bus allows, as measured, if None.
    """

    def __init__(self, servos: ServoGroup, cycle_time_s: float | None = None) -> None:
        self._servos, self._given_cycle_time_s = servos, cycle_time_s
        self._beat: ControlCycle | None = None

    @property
    def cycle_time_s(self) -> float:
        """The time between two goals, seconds.

        Raises:
            RefusedError: None was given, and that of the bus was not measured yet.
        """
        return self._given_cycle_time_s or self._servos.cycle_time_s

    @property
    def last_cycle(self) -> ControlCycle | None:
        """Return the last beat of the running motion, or of the last one."""
        return self._beat

    def request_stop(self, reason: StopReason) -> None:
        """Let the running motion brake and end with ``StoppedError``; safe from anywhere.

        A signal, another thread or a callback may call it. The stop stays until acknowledged; where
        nothing moves, it keeps the next motion from beginning.
        """
        self._servos.request_stop(reason)

    def run(
        self,
        course: Trajectory,
        on_cycle: OnCycle | None = None,
        *,
        speed_rad_s: float | None = None,
    ) -> Vector:
        """Carry a course out to its end.

        Args:
            course: What the joints shall do; it begins where their goals are now.
            on_cycle: Called at each beat.
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
            return self._run_loop(course, on_cycle)

    def _run_loop(self, course: Trajectory, on_cycle: OnCycle | None) -> Vector:
        servos, throttle, setpoints = (
            self._servos,
            TimeScaler(self.cycle_time_s),
            SetpointSampler(course),
        )
        told_s, there, restarts = servos.clock.now_s(), True, servos.restarts
        for _ in Rate(servos.clock, self.cycle_time_s):
            measured = servos.update()
            if servos.restarts > restarts:
                restarts = servos.restarts
                setpoints.restart_from(servos.goals())
            # One reading of the clock for the setpoint and for the guard that judges its step.
            now_s, before_s = servos.clock.now_s(), told_s
            gap_s = throttle.step(now_s - before_s, braking=bool(servos.stop_request))
            told_s = now_s
            setpoint = setpoints.next_setpoint(servos.allowed_advance_s(gap_s) if there else 0.0)
            there = servos.send_goals(setpoint, now_s)
            self._beat = self._make_cycle(
                setpoints.time_s, course.duration_s, measured, throttle.late_s
            )
            if on_cycle:
                on_cycle(self._beat)
            throttle.raise_if_too_slow()
            ended = there and setpoints.has_ended
            if ended or throttle.stopped:
                servos.stop_request.raise_if_set()
            if ended:
                return measured
        raise AssertionError("the metronome never ends")

    def _make_cycle(
        self, time_s: float, duration_s: float, measured: Vector, late_s: float
    ) -> ControlCycle:
        servos = self._servos
        now_s = min(time_s, duration_s)
        return ControlCycle(now_s, duration_s, servos.goals(), measured, late_s, servos.lost_joints)
