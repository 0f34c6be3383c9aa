"""The control loop with its rate, setpoints, pauses, and slowdown on a slow machine."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median

from ikservo.control.servo_group import ServoGroup
from ikservo.control.streamed_servos import STALL_S
from ikservo.errors import RefusedError
from ikservo.guard import StopReason
from ikservo.kinematics.arrays import FrozenArrays, Vector
from ikservo.motion import Rate, Trajectory, TrajectoryPoint

BRAKE_S = 0.25
"""Duration of braking from full speed to a stop, and of accelerating back to full speed [s]."""

_MAX_STEP_S = 0.02  # up to this gap a late cycle advances the motion by the elapsed time
_LATE_S = 0.025  # delay of a cycle that counts as late
# Largest excess of late cycles over good cycles; late cycles alone reach it in 6 s or more. Until
# then the motion only slows down, because no cycle advances it by more than ``_MAX_STEP_S``.
_LATE_CYCLES = 250


_CYCLE_TIMES_S = (0.002, 0.0025, 0.004, 0.005, 0.008, 0.01)  # the shortest possible one is used
_READINGS = 5  # number of readings with which the time of the bus is measured
# The first direction of joints is determined over this time.
_SOON_S = 0.1
# The bus is busy for a quarter of each cycle; the rest is for computing and retries.
_TIME_MARGIN = 4.0
_MIN_TIME_MARGIN = 1.25  # cycle of a slow bus, as a multiple of its busy time


def measure_cycle_time_s(servos: ServoGroup) -> float:
    """Read the positions a few times and choose the control cycle that the bus allows.

    Returns:
        The time between two goals: 500 to 100 Hz, or slower on a slow bus.

    Raises:
        BusError: A servo does not answer.
    """
    taken_s: list[float] = []
    for _ in range(_READINGS):
        start_s = servos.clock.now_s()
        servos.measure_positions()
        taken_s.append(servos.clock.now_s() - start_s)
    # All positions and the telemetry of one servo are read, and all goals are written.
    bus_s = median(taken_s) * (1.0 + 1.0 / len(servos.names)) + servos.goals_wire_s
    for cycle_time_s in _CYCLE_TIMES_S:
        if cycle_time_s >= _TIME_MARGIN * bus_s:
            return cycle_time_s
    return max(_CYCLE_TIMES_S[-1], _MIN_TIME_MARGIN * bus_s)


class TimeScaler:
    """Converter from clock time to the time of a motion.

    A motion whose time passes more slowly stays on its path and inside every limit. Motions brake
    in this way, and they restart in this way after a delay of the program.

    Args:
        cycle_time_s: The nominal time between two goals.

    Attributes:
        rate: Seconds of the motion per second of the clock, 0 to 1.
    """

    def __init__(self, cycle_time_s: float) -> None:
        self._cycle_time_s = cycle_time_s
        self._late_count = 0
        self.rate = 1.0

    @property
    def stopped(self) -> bool:
        """Whether the motion has been braked to a stop."""
        return self.rate <= 0.0

    def step(self, elapsed_s: float, *, braking: bool) -> float:
        """Process one control cycle, adapt the rate, and return the advance of the motion, s.

        Called once per cycle, before the lag of the joints is checked.
        """
        is_late = elapsed_s - self._cycle_time_s > _LATE_S
        self._late_count = max(0, self._late_count + (1 if is_late else -1))
        gap_s = min(elapsed_s, max(_MAX_STEP_S, 2.0 * self._cycle_time_s))
        if elapsed_s > STALL_S:
            self.rate = 0.0
        elif braking or self._late_count > _LATE_CYCLES:
            self.rate = max(0.0, self.rate - gap_s / BRAKE_S)
        else:
            self.rate = min(1.0, self.rate + gap_s / BRAKE_S)
        return self.rate * gap_s

    def raise_if_too_slow(self) -> None:
        """Raise an error if the motion was braked to a stop because the machine is too slow.

        Raises:
            RefusedError: The machine is too slow.
        """
        if self._late_count > _LATE_CYCLES and self.stopped:
            cycle_ms = 1000.0 * self._cycle_time_s
            raise RefusedError(
                f"The computer is too busy for a control cycle of {cycle_ms:.1f} ms; "
                "the arm was slowed down and stopped.",
                "Reduce the computer's load, then move again.",
            )


@dataclass(frozen=True, slots=True, eq=False)
class ControlCycle(FrozenArrays):
    """The goals and measurements of one control cycle.

    Attributes:
        time_s: The time of the trajectory, not of the clock.
        duration_s: The duration of the whole motion; infinite for a motion that continues until it
            is ended.
        goals: The servos' goals (n,), rad or m.
        reference: The reference of the joints (n,); goals lead it by the effect of load and
            friction.
        measured: The joints (n,); the last known position of a joint in ``lost``.
        lost: The joints whose reply is missing.
    """

    time_s: float
    duration_s: float
    goals: Vector
    reference: Vector
    measured: Vector
    lost: tuple[str, ...] = ()


# Servos that were stopped by their watchdogs return to the trajectory in this time.
_RETURN_S = 0.5


class SetpointSampler:
    """Sampler of a trajectory's positions while its time advances.

    After `restart_from`, the trajectory pauses while setpoints move on a straight path from the
    positions of the stopped joints back to the paused trajectory; then it continues.

    Attributes:
        time_s: The time of the trajectory.
    """

    def __init__(self, trajectory: Trajectory) -> None:
        self._trajectory = trajectory
        self.time_s = 0.0
        self._start: Vector | None = None
        self._returned_s = 0.0

    @property
    def has_ended(self) -> bool:
        """Whether the trajectory is at its end."""
        return self._start is None and self.time_s >= self._trajectory.duration_s

    def restart_from(self, position: Vector) -> None:
        """Restart from a position (n,), rad or m, where the servos were stopped."""
        self._start, self._returned_s = position, 0.0

    def next_setpoint(self, gap_s: float) -> TrajectoryPoint:
        """Advance the motion by a time and return its setpoint (n,), rad or m."""
        if self._start is None:
            self.time_s += gap_s
            return self._trajectory.state(self.time_s)
        self._returned_s += gap_s
        fraction = min(self._returned_s / _RETURN_S, 1.0)
        goal, start = self._trajectory.state(self.time_s).position, self._start
        if fraction >= 1.0:
            self._start = None
        return TrajectoryPoint.at_rest(start + fraction * (goal - start))


OnCycle = Callable[[ControlCycle], None]
"""Called in each control cycle; may retarget the trajectory or request a stop."""


class ControlLoop:
    """Loop that streams trajectories to the servos of one arm.

    Args:
        servos: The servos, torque on.
        cycle_time_s: Time between two goals; None measures the time that the bus allows.

    Attributes:
        on_every_cycle: Called in each control cycle of every trajectory; None if nobody watches.
    """

    def __init__(self, servos: ServoGroup, cycle_time_s: float | None = None) -> None:
        self._servos, self._cycle_time_s = servos, cycle_time_s
        self._last_cycle: ControlCycle | None = None
        self.on_every_cycle: OnCycle | None = None

    @property
    def cycle_time_s(self) -> float:
        """The time between two goals in seconds, without reading a servo.

        Raises:
            RefusedError: The time was neither given nor measured yet.
        """
        if self._cycle_time_s is None:
            raise RefusedError(
                "The control cycle of this arm has not been measured.",
                "Switch its torque on first.",
            )
        return self._cycle_time_s

    def measure_cycle_time_s(self) -> float:
        """Return the time between two goals; measure it first if necessary.

        Raises:
            BusError: A servo does not answer.
        """
        if self._cycle_time_s is None:
            self._cycle_time_s = measure_cycle_time_s(self._servos)
        return self._cycle_time_s

    @property
    def last_cycle(self) -> ControlCycle | None:
        """The last cycle of the running motion, or of the previous motion."""
        return self._last_cycle

    def request_stop(self, reason: StopReason) -> None:
        """Brake the running motion and end it with ``StoppedError``.

        A signal handler, another thread or a callback may call this method. The stop is latched
        until acknowledged; if nothing moves, the next motion is refused.
        """
        self._servos.request_stop(reason)

    def run(
        self,
        trajectory: Trajectory,
        on_cycle: OnCycle | None = None,
        *,
        speed_rad_s: float | None = None,
        profile_rad_s: float | None = None,
        compensated: bool = True,
    ) -> Vector:
        """Execute a trajectory to its end.

        Args:
            trajectory: The joint motion; it starts at the joint references.
            on_cycle: Called in each control cycle.
            speed_rad_s: The top speed of the motion at the horns, to which the servos are limited;
                the arm's maximum if None.
            profile_rad_s: The profile speed of the servos; None uses the speed of the motion.
            compensated: Whether the trajectory is the reference of the joints; otherwise, it
                consists of servo goals and starts at the present goals.

        Returns:
            The measured joints (n,) of the last cycle, rad or m.

        Raises:
            StoppedError: A stop was requested; the arm was braked and holds.
            ServoSilentError: A joint did not reply in three consecutive cycles; the others hold.
            ServoAlarmError: A servo reports a fault, or was reset; the arm holds.
            RefusedError: The guard stopped the motion, or a joint does not follow; the arm holds.
            PortLostError: The port was lost.
        """
        from ikservo.control.thread_priority import steady_timing  # noqa: PLC0415

        streaming = self._servos.streaming(speed_rad_s, profile_rad_s)
        with streaming, steady_timing(self._servos.clock):
            return self._run_loop(trajectory, on_cycle, compensated)

    def _run_loop(
        self, trajectory: Trajectory, on_cycle: OnCycle | None, compensated: bool
    ) -> Vector:
        servos, setpoints = self._servos, SetpointSampler(trajectory)
        cycle_time_s = self.measure_cycle_time_s()
        scaler = TimeScaler(cycle_time_s)
        sent_s, uncut, restarts = servos.clock.now_s(), True, servos.restarts
        ahead = _first_way(trajectory) if compensated else None
        if compensated:
            servos.begin_compensation(cycle_time_s)
        for _ in Rate(servos.clock, cycle_time_s):
            measured = servos.update()
            if servos.restarts > restarts:
                restarts = servos.restarts
                setpoints.restart_from(servos.goals())
                if compensated:
                    servos.begin_compensation(cycle_time_s)
            # The setpoint, and the guard that checks its step, use the same reading of the clock.
            now_s, before_s = servos.clock.now_s(), sent_s
            gap_s = scaler.step(now_s - before_s, braking=bool(servos.stop_request))
            sent_s = now_s
            advance_s = servos.allowed_advance_s(gap_s) if uncut else 0.0
            if ahead is not None:
                pushed = servos.compensator.preload(ahead, measured, gap_s)
                # After a stop request the motion does not begin.
                ahead = None if pushed and not servos.stop_request else ahead
                advance_s = advance_s if ahead is None else 0.0
            setpoint = setpoints.next_setpoint(advance_s)
            if compensated:
                uncut = servos.send_reference(setpoint, advance_s, now_s)
            else:
                uncut = servos.send_goals(setpoint.position, now_s)
            duration_s = trajectory.duration_s
            self._last_cycle = ControlCycle(
                min(setpoints.time_s, duration_s),
                duration_s,
                servos.goals(),
                setpoint.position,
                measured,
                servos.lost_joints,
            )
            for each in (on_cycle, self.on_every_cycle):
                if each:
                    each(self._last_cycle)
            scaler.raise_if_too_slow()
            ended = uncut and setpoints.has_ended
            if ended or scaler.stopped:
                servos.stop_request.raise_if_set()
            if ended:
                return measured
        raise AssertionError("the rate never ends")


def _first_way(trajectory: Trajectory) -> Vector | None:
    """Compute the first displacement of the joints (n,), rad or m; None if it may still change."""
    if math.isinf(trajectory.duration_s):
        return None
    return trajectory.state(_SOON_S).position - trajectory.state(0.0).position
