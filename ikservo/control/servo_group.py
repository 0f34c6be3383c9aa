"""The servos of an arm as one group: enable, read, send goals through the guard, stop."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import numpy as np

from ikservo.clock import Clock
from ikservo.control.enabling import (
    accepted_goal_range,
    clamp_goal,
    hold_ticks,
    prepare_servos,
    raise_gains,
    verify_goals,
    wait_until_settled,
    wait_until_still,
)
from ikservo.control.feedback import (
    Feedback,
    JointState,
    measure_cycle_time_s,
    read_joint_states,
    read_register,
    with_retries,
)
from ikservo.control.health_polling import HealthPoller
from ikservo.control.servo_limits import ServoRamLimits, limit_torque
from ikservo.control.stopping import CTRL_C, StopOutcome, StopRequest, hold_servos
from ikservo.control.torque_state import TorqueStateMachine
from ikservo.errors import HeldUpError, IkservoError, RefusedError, StoppedError
from ikservo.guard import (
    CommandLimits,
    Gate,
    HealthLimits,
    HealthMonitor,
    StopKind,
    StopReason,
    TrackingMonitor,
)
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.torque import check_supply_voltage, torque_off
from ikservo.kinematics.arrays import Vector
from ikservo.registers import RegisterName

__all__ = ["ServoGroup", "StreamedServos"]


# A joint that is further behind its goal than its load explains presses against something.
_PRESSING_LAG_RAD = math.radians(8.0)  # at the horn
# After a beat as long as this a lost answer is asked for once more.
_STALL_S = 0.1
# A motion goes on by itself after no longer and no more pauses of the program than these.
_MAX_PAUSE_S, _MAX_RESTARTS = 10.0, 10


class StreamedServos:
    """Measured joints out, goals in through the guard; ``ServoGroup`` adds what is done at rest.

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

    def __init__(self, bus: ServoBus, fences: Sequence[CommandLimits], clock: Clock) -> None:
        self._bus, self.clock = bus, clock
        self.fences = tuple(fences)
        self.names = tuple(fence.joint for fence in fences)
        self._ids = [fence.servo_id for fence in fences]
        self._gate = Gate(fences, self._write_goals, clock)
        self._feedback = Feedback(bus, fences)
        self._limits = ServoRamLimits(bus, self._ids)
        self._round: HealthPoller | None = None
        self._cycle_time_s: float | None = None
        self._beat_at_s = self._horn_rad_s = 0.0
        self.restarts = 0
        self.stop_request, self.torque = StopRequest(), TorqueStateMachine()
        self.warn: Callable[[str], None] = lambda _: None

    def measure_positions(self) -> Vector:
        """Return where the joints are (n,), rad or m, from the servos' own registers."""
        return self._feedback.measure_positions()

    def goals(self) -> Vector:
        """Return where the servos were last told to go (n,), rad or m."""
        return self._to_positions(self._gate.goals)

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
    def lost_joints(self) -> tuple[str, ...]:
        """Return the joints whose answer was missing at the last beat."""
        return self._feedback.lost_joints

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
            self._prepare_streaming(speed_rad_s)
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

    def update(self) -> Vector:
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
            return self._update_measured()
        except HeldUpError:
            if self.restarts >= _MAX_RESTARTS:
                raise
        self._restart_servos()
        return self.measure_positions()

    def _update_measured(self) -> Vector:
        now_s, before_s = self.clock.now_s(), self._beat_at_s
        self._beat_at_s = now_s
        _check_pause(now_s - before_s)
        measured = self._feedback.read()
        if self.lost_joints and now_s - before_s > _STALL_S:  # nobody has seen that joint for long
            now_s = self.clock.now_s()
            measured = self._feedback.read()
        # By what was sent since the cycle before began, none of which can be told from silence.
        self._limits.check_watchdog_gap(self.clock.now_s() - before_s)
        self._gate.update_measured(
            self._feedback.latest, now_s
        )  # which is no later than they were measured
        self._following.update(self.goals(), measured)
        if self._round:
            self._round.poll()
        return measured

    def _restart_servos(self) -> None:
        """Let servos that stopped themselves hold where they stand, and watch them again.

        Raises:
            BusError: A servo does not answer.
            ServoAlarmError: One is not well, or was reset.
        """
        self.restarts += 1
        self._limits.disarm_watchdog()
        self._limits.invalidate()
        self._limits.set_speed(self._horn_rad_s)
        now_s = self.clock.now_s()
        ticks = self._feedback.measure_ticks()
        self._gate.reset_goals(ticks)
        self._gate.update_measured(ticks, now_s)
        self._feedback.reset_losses()
        self._beat_at_s = prepare_servos(self._limits, self._round, self.clock, self._horn_rad_s)

    def allowed_advance_s(self, elapsed_s: float) -> float:
        """Return how far a motion may go on in a time, so that its goals stay near the joints."""
        return self._gate.allowed_advance_s(elapsed_s)

    def send_goals(self, positions: Vector, now_s: float) -> bool:
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
        if self._gate.stale_joints(now_s):
            return False
        wanted = self._to_ticks(positions)
        goals = self._gate.shorten_goals(wanted, now_s)
        self._gate.send(goals, now_s)
        return goals == wanted

    def hold(self, reason: StopReason) -> None:
        """Latch a stop and hold, until somebody acknowledges it; never raises.

        Every joint keeps the goal that stands, a little ahead of it; one that complains or cannot
        follow is told to stay where it is, so that it does not press on.
        """
        self._gate.latch_stop(reason)
        # Nobody answers to these packets: the first is sent twice, for one may be lost.
        for step in (self._hold_goals, self._hold_goals, self._limits.broadcast_watchdog_off):
            with contextlib.suppress(Exception):  # each is tried, whatever became of the others
                step()

    def _prepare_streaming(self, speed_rad_s: float | None) -> None:
        horns = {f.joint: f.joint_map.unit_per_horn_rad for f in self.fences}
        speeds = {f.joint: f.speed for f in self.fences}
        if speed_rad_s is not None:
            speeds = {name: min(speed_rad_s * horns[name], speeds[name]) for name in speeds}
        self._gate.set_speeds(speeds)
        self._following = TrackingMonitor.for_limits(self.fences, speeds)
        self._feedback.reset_losses()
        self._horn_rad_s, self.restarts = max(speeds[name] / horns[name] for name in speeds), 0
        self._beat_at_s = prepare_servos(self._limits, self._round, self.clock, self._horn_rad_s)

    def _hold_goals(self) -> None:
        self._gate.hold({name: self._hold_tick(name) for name in self._gate.goals})

    def _hold_tick(self, joint: str) -> int:
        fence, goal = self.fences[self.names.index(joint)], self._gate.goals[joint]
        seen = self._gate.measured_ticks.get(joint, goal)
        presses = abs(goal - seen) * fence.joint_map.horn_rad_per_tick > _PRESSING_LAG_RAD
        return seen if presses or self._bus.alarms.get(fence.servo_id) else goal

    def _reason_of(self, error: BaseException) -> StopReason:
        """Tell for what reason a motion has ended: the requested one, or the error."""
        interrupted = isinstance(error, (StoppedError, KeyboardInterrupt))
        requested = self.stop_request.reason
        return requested if interrupted and requested is not None else _reason_of(error)

    def _write_goals(self, goals: Mapping[int, int]) -> None:
        self._bus.sync_write(RegisterName.GOAL_POSITION, goals, raw=True)

    def _to_ticks(self, positions: Vector) -> dict[str, int]:
        return {
            fence.joint: fence.tick(float(position))
            for fence, position in zip(self.fences, positions, strict=True)
        }

    def _to_positions(self, ticks: Mapping[str, int]) -> Vector:
        return np.array([f.joint_map.position(ticks[f.joint]) for f in self.fences])


def _check_pause(elapsed_s: float) -> None:
    """Refuse to go on by itself after a pause in which a person may have come near the arm.

    Raises:
        RefusedError: It was too long.
    """
    if elapsed_s > _MAX_PAUSE_S:
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


# How long an arm that sinks is waited for, in all, before it is planned for.
_SINK_TIME_S = 0.5
# An arm that fell past the goals at which it was to be caught gets new ones so often.
_MAX_CATCHES = 3


class ServoGroup(StreamedServos):
    """Every joint's servo on one bus, in the order of ``names``.

    Args:
        bus: The line.
        fences: What each joint's servo may be told.
        shadows: Servo ids that turn a joint besides, by joint.
        clock: The line's time.
        health: What a servo may be asked to bear.
        gripper: The joint that may hold something, with no more force than a person said.
    """

    def __init__(
        self,
        bus: ServoBus,
        fences: Sequence[CommandLimits],
        shadows: Mapping[str, Sequence[int]],
        clock: Clock,
        health: HealthLimits | None = None,
        gripper: str | None = None,
    ) -> None:
        super().__init__(bus, fences, clock)
        self._gripper, self._patience_s = gripper, _SINK_TIME_S
        self._shadows = {i: f"{n} (servo {i})" for n in self.names for i in shadows.get(n, ())}
        self._health = HealthLimits() if health is None else health

    def enable(self, speed_rad_s: float) -> None:
        """Switch torque on without a twitch: each servo's goal is where it is, then torque.

        A servo that already holds keeps its goal, for its load has pulled it a little below.

        Args:
            speed_rad_s: The fastest each servo's horn may turn by itself.

        Raises:
            ServoAlarmError: A servo's supply is outside its own limits; no torque was switched.
            RefusedError: A joint stands far outside what its servo allows, or the arm was stopped
                and nobody has acknowledged it; likewise.
            ServoRefusedError: A servo keeps an old goal; likewise.
        """
        torque = read_register(self._bus, self._ids, RegisterName.TORQUE_ENABLE)
        self.torque.enabling(was_on=all(torque.values()))
        for fence in self.fences:
            grips = fence.joint == self._gripper and torque[fence.servo_id] != 0
            with_retries(self.clock, partial(self._prepare_servo, fence, grips=grips))
        self._limits.invalidate()
        self._limits.set_speed(speed_rad_s)
        start = self._start_ticks()
        self._gate.reset_goals(start)
        verify_goals(self._bus, {fence.servo_id: start[fence.joint] for fence in self.fences})
        for fence in self.fences:
            switch_on = partial(
                self._bus.write, fence.servo_id, RegisterName.TORQUE_ENABLE, 1, raw=True
            )
            with_retries(self.clock, switch_on)
        if not all(torque.values()):
            self._catch_falling_joints(start)
        if self._cycle_time_s is None:  # not before: a limp arm would sink meanwhile
            self.measure_cycle_time_s()
        names = dict(zip(self._ids, self.names, strict=True)) | self._shadows
        health = HealthMonitor(self._health, self._supply_v(names))
        self._round = HealthPoller(self._bus, names, self._limits, health, self._log_warning)
        self.torque.enabled()

    @contextmanager
    def tolerate_heat(self) -> Generator[None]:
        """Let heat alone stop no motion for which torque is switched on meanwhile.

        A servo that is too hot to go on must be let go, and before that the arm must come down.
        """
        usual, self._health = self._health, replace(self._health, hold_c=math.inf)
        try:
            yield
        finally:
            self._health = usual

    @property
    def overheated(self) -> bool:
        """Return whether a servo was so hot in the last motion that it must be let go."""
        return self._round is not None and self._round.is_overheated

    def measured_hold_positions(self) -> Vector:
        """Return where ``enable`` would let the joints hold (n,), rad or m; nothing is written.

        That is where they are, or the goals of those that hold already: load has pulled such a
        joint below its goal, and a motion begins at the goal. An arm that sinks is waited for.

        Raises:
            BusError: A servo does not answer.
            RefusedError: A joint stands far outside what its servo allows.
        """
        if self._patience_s > 0.0 and not self.read_torque_on():
            since_s = self.clock.now_s()
            wait_until_still(self.fences, self._feedback, self.clock, self._patience_s)
            self._patience_s -= self.clock.now_s() - since_s
        return self._to_positions(self._start_ticks())

    def read_torque_on(self) -> bool:
        """Read whether every servo's torque is on."""
        return all(read_register(self._bus, self._ids, RegisterName.TORQUE_ENABLE).values())

    def disable_torque(self) -> None:
        """Switch torque off on every servo, also when some fail.

        Raises:
            BusError: The first failure, after all were tried.
        """
        self._patience_s = _SINK_TIME_S
        self.torque.releasing()
        failures = torque_off(self._bus, (*self._ids, *self._shadows))
        for error in failures.values():
            raise error
        self.torque.released()

    def reconnect(self, serial_number: str, within_s: float) -> None:
        """Open the line again once its adapter is back, and stay stopped; see ``Arm.reconnect``."""
        self.torque.reconnected()
        self._bus.reconnect(serial_number, within_s)
        self._gate.latch_stop(StopReason(StopKind.UNPLUGGED, "device unplugged"))
        self._feedback.measure_ticks()

    def hold_measured(self, reason: StopReason) -> StopOutcome:
        """Latch a stop and hold where the joints are measured, while no control loop runs.

        Servos that another program has set in motion are stopped; torque is not switched.
        """
        self._gate.latch_stop(reason)
        return hold_servos(self._bus, self.fences, self.clock)

    def limit_force(self, joint: str, share: float) -> None:
        """Limit how hard a joint's servo may press until its torque is switched on anew.

        Raises:
            RegisterAccessError: The servo has no such limit.
        """
        limit_torque(self._bus, self._ids[self.names.index(joint)], share)

    def check_goal(self, positions: Vector, start: Vector) -> None:
        """Check a distant goal (n,) before a motion to it from ``start`` (n,) begins.

        Raises:
            RefusedError: A joint would leave its limits.
        """
        self._gate.check_range(self._to_ticks(positions), self._to_ticks(start))

    def clamp_to_limits(self, positions: Vector) -> Vector:
        """Return the positions (n,) that the guard would pass, nearest to the given ones."""
        ticks = self._to_ticks(positions)
        return self._to_positions({name: self._gate.clamp(name, ticks[name]) for name in ticks})

    def with_latest_telemetry(self, states: tuple[JointState, ...]) -> tuple[JointState, ...]:
        """Return joints' states with what their servos have told in motion since; asks nobody."""
        return self._round.with_latest_telemetry(states) if self._round else states

    def read_states(self) -> tuple[JointState, ...]:
        """Return every joint's position, limits, temperature, voltage, load and torque."""
        return read_joint_states(self._bus, self.fences, self._feedback.measure_ticks())

    def _catch_falling_joints(self, start: dict[str, int]) -> None:
        """Wait until all joints stand near their goals; where one fell past, it holds there."""
        for _ in range(_MAX_CATCHES):
            if wait_until_settled(self.fences, start, self._feedback, self.clock):
                return
            start = self._start_ticks()
            self._gate.reset_goals(start)

    def _prepare_servo(self, fence: CommandLimits, *, grips: bool) -> None:
        """Make one servo ready to hold.

        Args:
            fence: Of its joint.
            grips: Whether it may hold something now; its torque limit then stays as it is.
        """
        check_supply_voltage(self._bus, fence.servo_id)
        self._limits.prepare(fence.servo_id, keep_torque=grips)
        raise_gains(self._bus, fence.servo_id, jaws=fence.joint == self._gripper)

    def _start_ticks(self) -> dict[str, int]:
        """Return where each servo shall hold; the joints are measured last, for limp ones fall."""
        taken = {f.joint: accepted_goal_range(self._bus, f.servo_id) for f in self.fences}
        ticks = hold_ticks(self._bus, self.fences, self._feedback)
        return {f.joint: clamp_goal(f, ticks[f.joint], taken[f.joint]) for f in self.fences}

    def _supply_v(self, names: Mapping[int, str]) -> dict[str, tuple[float, float]]:
        """Return by what a servo is called what it says that it may be fed with, volts."""
        low = read_register(self._bus, list(names), RegisterName.MIN_VOLTAGE_LIMIT)
        high = read_register(self._bus, list(names), RegisterName.MAX_VOLTAGE_LIMIT)
        return {name: self._voltage_range(servo_id, low, high) for servo_id, name in names.items()}

    def _voltage_range(
        self, servo_id: int, low: Mapping[int, int], high: Mapping[int, int]
    ) -> tuple[float, float]:
        table = self._bus.servos[servo_id].table
        least = table.find(RegisterName.MIN_VOLTAGE_LIMIT).to_value(low[servo_id])
        return least, table.find(RegisterName.MAX_VOLTAGE_LIMIT).to_value(high[servo_id])

    def _log_warning(self, words: str) -> None:
        self.warn(words)
