"""Servos that are told goals beat by beat: heard, judged, and stopped when anything goes wrong."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Generator, Mapping, Sequence

import numpy as np

from ikservo.arm.streaming.arming import arm_servos
from ikservo.arm.streaming.feedback import Feedback
from ikservo.arm.streaming.halt import CTRL_C, StopKind, StopReason, StopRequest
from ikservo.arm.streaming.health_round import HealthRound
from ikservo.arm.streaming.limits_in_servos import LimitsInServos
from ikservo.arm.streaming.rate import measure_cycle_time_s
from ikservo.arm.streaming.torque_state import TorqueStateMachine
from ikservo.clock import Clock
from ikservo.errors import HeldUpError, IkservoError, RefusedError, StoppedError
from ikservo.guard import Fence, Following, Gate
from ikservo.hardware.bus import ServoBus
from ikservo.kinematics.se3 import Vector
from ikservo.registers import Role

__all__ = ["StreamedServos"]

# A joint that is further behind its goal than its load explains presses against something.
_PRESSING_RAD = math.radians(8.0)  # at the horn
# After a beat as long as this a lost answer is asked for once more.
_STALL_S = 0.1
# A motion goes on by itself after no longer and no more pauses of the program than these.
_LONGEST_PAUSE_S, _MOST_RESTARTS = 10.0, 10


class StreamedServos:
    """Measured joints out, goals in through the guard; ``Servos`` adds what is done at rest.

    Args:
        bus: The line.
        fences: What each joint's servo may be told.
        clock: The line's time.

    Attributes:
        clock: Likewise.
        fences: Likewise.
        names: The joints, in the order of the vectors.
        stop_request: Requests that the running motion ends.
        torque: Whether the servos hold, and whether a control loop runs.
        restarts: How often in this motion the servos had stopped themselves, because the program
            was held up, and were started again from where they stood.
        warn: Called with what a person should know, in words; nobody listens at first.
    """

    def __init__(self, bus: ServoBus, fences: Sequence[Fence], clock: Clock) -> None:
        self._bus, self.clock = bus, clock
        self.fences = tuple(fences)
        self.names = tuple(fence.joint for fence in fences)
        self._ids = [fence.servo_id for fence in fences]
        self._gate = Gate(fences, self._write_goals, clock)
        self._feedback = Feedback(bus, fences)
        self._limits = LimitsInServos(bus, self._ids)
        self._round: HealthRound | None = None
        self._cycle_time_s: float | None = None
        self._beat_at_s = self._horn_rad_s = 0.0
        self.restarts = 0
        self.stop_request, self.torque = StopRequest(), TorqueStateMachine()
        self.warn: Callable[[str], None] = lambda _: None

    def measure(self) -> Vector:
        """Return where the joints are (n,), rad or m, from the servos' own registers."""
        return self._feedback.measure()

    def goals(self) -> Vector:
        """Return where the servos were last told to go (n,), rad or m."""
        return self._positions(self._gate.goals)

    @property
    def cycle_time_s(self) -> float:
        """The time between two goals, as last measured; reads no servo.

        Raises:
            RefusedError: It was not measured yet.
        """
        if self._cycle_time_s is None:
            raise RefusedError(
                "The control cycle of this arm has not been measured.",
                "Switch its torque on first.",
            )
        return self._cycle_time_s

    def measure_cycle_time_s(self) -> float:
        """Choose the time between two goals by what reading the bus takes now: five reads.

        Raises:
            BusError: A servo does not answer.
        """
        self._cycle_time_s = measure_cycle_time_s(self._bus, self._feedback)
        return self._cycle_time_s

    @property
    def lost(self) -> tuple[str, ...]:
        """Return the joints whose answer was missing at the last beat."""
        return self._feedback.lost

    @property
    def stop_reason(self) -> StopReason | None:
        """Why the arm was stopped, until that is acknowledged; None where it is not."""
        return self._gate.stop_reason

    def check_stop(self) -> None:
        """Raise while a stop was not acknowledged.

        Raises:
            RefusedError: The arm was stopped; says why.
        """
        self._gate.check_stop()

    def request_stop(self, reason: StopReason) -> None:
        """End the running motion, or let the next one not begin; safe from anywhere."""
        self.stop_request.set(reason)
        if not self.torque.is_moving:
            self._gate.latch_stop(reason)

    def latch_stop(self, reason: StopReason) -> None:
        """Let nothing move until somebody acknowledges it; sends the servos nothing."""
        self._gate.latch_stop(reason)

    def acknowledge(self) -> None:
        """Let the arm be moved again after a stop; torque is checked and set anew first.

        A motion that was stopped ends nevertheless: where one still runs, this counts once it has.
        """
        if self.stop_request.motion_running:
            self.stop_request.acknowledged = bool(self.stop_request)
            return
        self._gate.acknowledge()
        self.stop_request.clear()
        self.torque.acknowledged()

    def acknowledge_ended(self) -> None:
        """Acknowledge a stop that was acknowledged before the motion it stopped had ended."""
        if self.stop_request.acknowledged:
            self.acknowledge()

    @contextlib.contextmanager
    def streaming(self, speed_rad_s: float | None) -> Generator[None]:
        """Be ready for goals beat by beat; whatever goes wrong within, the arm is stopped.

        Args:
            speed_rad_s: The top speed of the motion at the horns; the fences' if None.

        Raises:
            BusError: A servo does not answer.
            ServoAlarmError: A servo is not well.
            RefusedError: The arm was stopped, its torque was never switched on, or it moves
                already; that motion goes on.
            StoppedError: A stop was requested while no control loop looked at requests.
        """
        self.torque.check_idle()
        try:
            self.stop_request.raise_if_set()  # requested between two loops of one motion
            self._ready(speed_rad_s)
            self.torque.loop_started()
            yield
            self._limits.disarm_watchdog()
            self.torque.loop_ended()
            self.stop_request.raise_if_set()  # requested after the last cycle
        except BaseException as error:
            self.hold(self._reason_of(error))
            self.torque.faulted()
            raise
        finally:
            self.torque.loop_ended()

    def beat(self) -> Vector:
        """Hear where the joints are (n,), and one of them how it is; rad or m.

        Servos that stopped themselves while the program was held up are started again from where
        they stand, and ``restarts`` says so; goals begin there, too.

        Raises:
            ServoSilentError: A joint gave no answer for three beats in a row.
            ServoAlarmError: A servo is not well, or was reset.
            RefusedError: A joint does not follow its goal.
            HeldUpError: The program was held up too long, or too often.
        """
        self.stop_request.raise_if_without_braking()
        try:
            return self._heard()
        except HeldUpError:
            if self.restarts >= _MOST_RESTARTS:
                raise
        self._restart()
        return self.measure()

    def _heard(self) -> Vector:
        now_s, before_s = self.clock.now_s(), self._beat_at_s
        self._beat_at_s = now_s
        _check_pause(now_s - before_s)
        measured = self._feedback.beat()
        if self.lost and now_s - before_s > _STALL_S:  # nobody has seen that joint for long
            now_s = self.clock.now_s()
            measured = self._feedback.beat()
        # By what was sent since the cycle before began, none of which can be told from silence.
        self._limits.check_gap(self.clock.now_s() - before_s)
        self._gate.see(self._feedback.fresh, now_s)  # which is no later than they were measured
        self._following.see(self.goals(), measured)
        if self._round:
            self._round.beat()
        return measured

    def _restart(self) -> None:
        """Let servos that stopped themselves hold where they stand, and watch them again.

        Raises:
            BusError: A servo does not answer.
            ServoAlarmError: One is not well, or was reset.
        """
        self.restarts += 1
        self._limits.disarm_watchdog()
        self._limits.forget()
        self._limits.run_at(self._horn_rad_s)
        now_s = self.clock.now_s()
        ticks = self._feedback.ticks()
        self._gate.start_from(ticks)
        self._gate.see(ticks, now_s)
        self._feedback.begin()
        self._beat_at_s = arm_servos(self._limits, self._round, self.clock, self._horn_rad_s)

    def advance_s(self, elapsed_s: float) -> float:
        """Return how far a motion may go on in a time, so that its goals stay near the joints."""
        return self._gate.advance_s(elapsed_s)

    def command(self, positions: Vector, now_s: float) -> bool:
        """Send goals (n,), rad or m, through the guard, as far as they may go now.

        While a joint has no recent position reading nothing is sent: the arm holds.

        Args:
            positions: The goals.
            now_s: The reading of the clock by which they were worked out.

        Returns:
            Whether the goals are where they were wanted: a step that is too long is cut.

        Raises:
            RefusedError: The guard will not pass them; nothing was sent.
        """
        self.stop_request.raise_if_without_braking()
        if self._gate.unseen(now_s):
            return False
        wanted = self._ticks(positions)
        goals = self._gate.cut(wanted, now_s)
        self._gate.send(goals, now_s)
        return goals == wanted

    def hold(self, reason: StopReason) -> None:
        """Latch a stop and hold, until somebody acknowledges it; never raises.

        Every joint keeps the goal that stands, a little ahead of it; one that complains or cannot
        follow is told to stay where it is, so that it does not press on.
        """
        self._gate.latch_stop(reason)
        # Nobody answers to these packets: the first is sent twice, for one may be lost.
        for step in (self._hold_goals, self._hold_goals, self._limits.drop_watchdog):
            with contextlib.suppress(Exception):  # each is tried, whatever became of the others
                step()

    def _ready(self, speed_rad_s: float | None) -> None:
        horns = {f.joint: f.joint_map.unit_per_tick / f.joint_map.horn_rad_per_tick
                 for f in self.fences}  # fmt: skip
        speeds = {f.joint: f.speed for f in self.fences}
        if speed_rad_s is not None:
            speeds = {name: min(speed_rad_s * horns[name], speeds[name]) for name in speeds}
        self._gate.run_at(speeds)
        self._following = Following.of(self.fences, speeds)
        self._feedback.begin()
        self._horn_rad_s, self.restarts = max(speeds[name] / horns[name] for name in speeds), 0
        self._beat_at_s = arm_servos(self._limits, self._round, self.clock, self._horn_rad_s)

    def _hold_goals(self) -> None:
        self._gate.hold({name: self._holding_tick(name) for name in self._gate.goals})

    def _holding_tick(self, joint: str) -> int:
        fence, goal = self.fences[self.names.index(joint)], self._gate.goals[joint]
        seen = self._gate.seen.get(joint, goal)
        presses = abs(goal - seen) * fence.joint_map.horn_rad_per_tick > _PRESSING_RAD
        return seen if presses or self._bus.alarms.get(fence.servo_id) else goal

    def _reason_of(self, error: BaseException) -> StopReason:
        """Tell for what reason a motion has ended: the requested one, or the error."""
        interrupted = isinstance(error, (StoppedError, KeyboardInterrupt))
        requested = self.stop_request.reason
        return requested if interrupted and requested is not None else _reason_of(error)

    def _write_goals(self, goals: Mapping[int, int]) -> None:
        self._bus.sync_write(Role.GOAL_POSITION, goals, raw=True)

    def _ticks(self, positions: Vector) -> dict[str, int]:
        return {
            fence.joint: fence.tick(float(position))
            for fence, position in zip(self.fences, positions, strict=True)
        }

    def _positions(self, ticks: Mapping[str, int]) -> Vector:
        return np.array([f.joint_map.position(ticks[f.joint]) for f in self.fences])


def _check_pause(elapsed_s: float) -> None:
    """Refuse to go on by itself after a pause in which a person may have come near the arm.

    Raises:
        RefusedError: It was too long.
    """
    if elapsed_s > _LONGEST_PAUSE_S:
        raise RefusedError(
            f"The program was delayed by {elapsed_s:.0f} s in the middle of a motion; "
            "torque stays on.",
            "Look at the arm, then move it again.",
        )


def _reason_of(error: BaseException) -> StopReason:
    if isinstance(error, KeyboardInterrupt):
        return CTRL_C
    return StopReason(StopKind.FAULT, _text_of(error))


def _text_of(error: BaseException) -> str:
    if isinstance(error, IkservoError):
        return error.message
    if isinstance(error, MemoryError):
        return "The program ran out of memory during the motion."
    if isinstance(error, (SystemExit, GeneratorExit)):
        return "The program ended during the motion."
    words = f"{type(error).__name__}: {error}".removesuffix(": ")
    return f"The program failed during the motion ({words})."
