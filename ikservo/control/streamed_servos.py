"""Read the joints and send goals through the guard in every cycle of a control loop."""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Callable, Generator, Mapping, Sequence

import numpy as np

from ikservo.clock import Clock
from ikservo.control.goal_compensation import GoalCompensator
from ikservo.control.health_polling import HealthPoller, prepare_servos
from ikservo.control.joint_reading import Feedback
from ikservo.control.stop_requests import StopRequest, check_pause, fault_reason
from ikservo.control.torque_state import TorqueStateMachine
from ikservo.control.watchdog_and_torque_limits import ServoRamLimits, unwatched_servos
from ikservo.errors import (
    HeldUpError,
    IkservoError,
    RefusedError,
    RegisterAccessError,
    ServoAlarmError,
    ServoSilentError,
    StoppedError,
)
from ikservo.guard import (
    DrivenJoint,
    Gate,
    OverloadMonitor,
    PassedGoals,
    StopReason,
    TrackingMonitor,
    overweight_error,
    power_lost_error,
    say_what_fell,
    torque_lost_error,
)
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.goal_writing import write_goals
from ikservo.kinematics.arrays import Vector
from ikservo.motion import TrajectoryPoint
from ikservo.registers import RegisterName

# A joint that lags its goal by this much more than its load explains presses against something.
_PRESSING_LAG_RAD = math.radians(8.0)  # at the horn
# A resting joint further from its reference, at the horn, was moved by something else.
_REFERENCE_TOLERANCE_RAD = 0.01
STALL_S = 0.1
"""Gap between two cycles [s] after which joints with lost replies are read again and the motion
does not advance: it accelerates again from a stop."""
_MAX_RESTARTS = 10  # after more restarts a motion does not continue by itself
_KEPT_WARNINGS = 50  # number of the latest warnings that are kept


class StreamedServos:
    """Reader of joints and sender of goals via the guard; ``ServoGroup`` adds actions at rest.

    Args:
        bus: The servo bus.
        driven_joints: The joints, each with its servo, limits and speed.
        clock: The clock of the bus.

    Attributes:
        names: Names of the joints, in the order used in vectors (n,).
        stop_request: The request to end the running motion, if there is one.
        torque: Whether the servos hold, and whether a control loop is running.
        restarts: Number of times in this motion that the servos were started again after their
            watchdogs stopped them, because the program was delayed.
        overload: Predicts when a servo will protect itself, and pulls back goals of pressing
            joints.
        warnings: The last warnings for the user, the oldest first.
        warn: Called with each warning; by default, warnings are ignored.
    """

    def __init__(self, bus: ServoBus, driven_joints: Sequence[DrivenJoint], clock: Clock) -> None:
        self._bus, self.clock = bus, clock
        self.driven_joints = tuple(driven_joints)
        self.names = tuple(driven.joint for driven in driven_joints)
        self._ids = [driven.servo_id for driven in driven_joints]
        self._tick_ranges = {driven.servo_id: driven.tick_range for driven in driven_joints}
        self._gate = Gate(driven_joints, clock)
        self.overload = OverloadMonitor(driven_joints)
        self._feedback = Feedback(bus, driven_joints)
        self.compensator = GoalCompensator(driven_joints)
        self._reference = self._measured = np.zeros(len(self.driven_joints))
        self._per_horn_rad = np.array(
            [driven.joint_map.unit_per_horn_rad for driven in driven_joints]
        )
        self._reference_s = 0.0
        self._uncut = True
        self._limits = ServoRamLimits(bus, self._ids, unwatched_servos(driven_joints))
        self._health_poller: HealthPoller | None = None
        self._cycle_at_s = self._horn_rad_s = 0.0
        self.restarts = 0
        self.stop_request, self.torque = StopRequest(), TorqueStateMachine()
        self.warnings: deque[str] = deque(maxlen=_KEPT_WARNINGS)
        self.warn: Callable[[str], None] = lambda _: None

    def measure_positions(self) -> Vector:
        """Read the joint positions (n,), rad or m."""
        self._measured = self._feedback.measure_positions()
        return self._measured

    @property
    def measured(self) -> Vector:
        """The joints (n,) as they were last measured, rad or m."""
        return self._measured

    def goals(self) -> Vector:
        """Return the last goals sent (n,), rad or m.

        Raises:
            StoppedError: A stop was acknowledged since this thread's motion was requested.
            RefusedError: No goals have been sent since torque was off.
        """
        known = [goal for goal in self._gate.goals if goal is not None]
        if len(known) < len(self.driven_joints):  # another thread acknowledged a stop meanwhile
            self.stop_request.check_request()
            raise RefusedError(
                "The servos have no goals yet.", "Nothing was sent. Request the motion again."
            )
        return self._to_positions(known)

    def reference(self) -> Vector:
        """Compute the joint references (n,), rad or m, at which motions start.

        Goals lead the reference by the effect of load and friction. The reference of a joint
        outside the chain, such as a gripper, is its goal, because it may press on something.
        """
        return np.where(self.compensator.corrects, self._reference, self.goals())

    def set_reference(self, positions: Vector) -> None:
        """Set the reference of the joints (n,), rad or m; their goals stay."""
        self._reference = positions

    def refresh_reference(self) -> Vector:
        """Measure the joints at rest; move the reference of a joint that is far from its reference.

        When torque is switched on, a limp arm sags as far as its load and friction predict. The
        reference is then not moved, and the next motion begins by lifting the arm.

        Returns:
            The reference (n,), rad or m.

        Raises:
            BusError: A servo does not answer.
            ServoAlarmError: A joint has fallen, because its servo has lost its torque.
        """
        measured, goals = self.measure_positions(), self.goals()
        low, high = self.compensator.stuck_offsets(self._reference)
        sagged = np.clip(measured, goals - high, goals - low)
        expected = np.where(self._reference == goals, sagged, self._reference)
        moved = np.abs(measured - expected) > _REFERENCE_TOLERANCE_RAD * self._per_horn_rad
        if moved.any():
            try:
                self._check_torque()
            except ServoAlarmError as error:
                self.torque.faulted()  # torque is enabled again before the next motion
                raise self._find_power_loss(error) or error from None
        self._reference = np.where(moved, measured, self._reference)
        return self.reference()

    def _check_torque(self) -> None:
        """Read the torque of all servos."""
        self._bus.sync_read(self._ids, RegisterName.TORQUE_ENABLE, raw=True)
        limp = self._limp_joints()
        if limp:
            raise torque_lost_error(limp)

    def begin_compensation(self, cycle_time_s: float) -> None:
        """Begin a motion at the reference with the present goals, each held for a cycle."""
        reference, goals = self.reference(), self.goals()
        self.compensator.begin(reference, goals, cycle_time_s, self._measured)
        self._reference_s, self._uncut = self.clock.now_s(), True

    def send_reference(self, point: TrajectoryPoint, advance_s: float, now_s: float) -> bool:
        """Send the goals for a reference (n,), rad or m, at ``now_s``; see ``send_goals``."""
        elapsed_s = now_s - self._reference_s
        if elapsed_s > STALL_S:  # the joints have come to rest
            self.compensator.begin(self.reference(), self.goals(), measured=self._measured)
        rate = min(advance_s / elapsed_s, 1.0) if elapsed_s > 0.0 else 1.0
        since_s = 0.5 * (self._cycle_at_s + now_s) - self._reference_s
        fresh = ~np.isin(self.names, self.lost_joints)
        ease = np.array(self._gate.eases())
        grow = self._uncut * ease * ~np.isin(self.names, self.overload.relaxed_joints)
        self.compensator.observe(self._measured, since_s, elapsed_s, fresh=fresh, grow=grow)
        goals = self.compensator.goals(point, elapsed_s, rate, ease)
        self._uncut = self.send_goals(goals, now_s, point.position)
        self._reference, self._reference_s = point.position, now_s
        return self._uncut

    @property
    def goals_wire_s(self) -> float:
        """The transmission time of goals for all servos, which do not reply to them."""
        header = 14
        each = 1 + next(iter(self._bus.servos.values())).table.goal_position.size
        return self._bus.port.wire_s(header + each * len(self._bus.servos))

    @property
    def lost_joints(self) -> tuple[str, ...]:
        """The joints whose reply was missing in the last cycle."""
        return self._feedback.lost_joints

    @property
    def stop_reason(self) -> StopReason | None:
        """The reason for the stop, until it is acknowledged; None if the arm is not stopped."""
        return self._gate.stop_reason

    def check_stop(self) -> None:
        """Check that no stop is waiting for an acknowledgement.

        Raises:
            RefusedError: The arm was stopped; the message says why.
        """
        self._gate.check_stop()

    def request_stop(self, reason: StopReason) -> None:
        """End the running motion, or refuse the next one; safe from signals and threads."""
        self.stop_request.set(reason)
        if not self.torque.is_moving:
            self._gate.latch_stop(reason)

    def latch_stop(self, reason: StopReason) -> None:
        """Refuse motions until ``acknowledge``; nothing is sent to the servos."""
        if reason is not self.stop_request.reason:  # the stop was counted when it was requested
            self.stop_request.count_stop(reason)
        self._gate.latch_stop(reason)

    def acknowledge(self) -> None:
        """Allow motions after a stop; before the next one, torque is checked and switched on again.

        While the stopped motion is still running, the acknowledgement takes effect at its end.
        """
        if self.stop_request.motion_running:
            self.stop_request.acknowledged = bool(self.stop_request)
            return
        self._gate.acknowledge()
        self.stop_request.clear()
        self.torque.acknowledged()

    def acknowledge_ended(self) -> None:
        """Complete an acknowledgement that was given before the stopped motion had ended."""
        if self.stop_request.acknowledged:
            self.acknowledge()

    @contextlib.contextmanager
    def streaming(
        self, speed_rad_s: float | None, profile_rad_s: float | None = None
    ) -> Generator[None]:
        """Prepare the servos for goals in every cycle; an error in the block stops the arm.

        Args:
            speed_rad_s: The motion's top speed at the horns; None uses the top speed of each joint.
            profile_rad_s: The profile speed of the servos; None uses the speed of the motion.

        Raises:
            BusError: A servo does not answer.
            ServoAlarmError: A servo reports a fault.
            RefusedError: The arm was stopped, its torque was never switched on, or it is already
                moving; the present motion continues.
            StoppedError: A stop was requested between two control loops.
        """
        self.torque.check_idle()
        try:
            self.stop_request.raise_if_set()  # a stop was requested between two loops of one motion
            self._prepare_streaming(speed_rad_s, profile_rad_s)
            self.torque.loop_started()
            yield
            self._limits.disarm_watchdog()
            if self._limits.may_have_tripped(self.clock.now_s() - self._cycle_at_s):
                # Servos that a watchdog stopped have lost their goals and limits.
                self._limits.invalidate()
                self._limits.set_speed(self._horn_rad_s)
                self._hold_goals()
            if self.overload.relaxes:  # while servos hold, nothing is read
                goals = self.overload.relaxed_goals(self._gate.goals, self._feedback.latest)
                if any(goal is not None for goal in goals):
                    self._send(self._gate.pass_hold(goals))
            self.torque.loop_ended()
            self.stop_request.raise_if_set()  # a stop was requested after the last cycle
        except BaseException as error:
            cause = error
            try:
                cause = self._find_power_loss(error) or error
            finally:
                interrupted = isinstance(cause, (StoppedError, KeyboardInterrupt))
                requested = self.stop_request.reason if interrupted else None
                self.hold(requested or fault_reason(cause))
                self.torque.faulted()
            if cause is not error:
                raise cause from error
            raise
        finally:
            self.torque.loop_ended()

    def update(self) -> Vector:
        """Read the joints (n,), rad or m, and the telemetry of one servo.

        Servos that their watchdogs stopped while the program was delayed are started again at their
        positions, and goals continue from there; ``restarts`` counts this.

        Raises:
            BusError: A servo that must be started again does not answer.
            ServoSilentError: A joint did not reply in three consecutive cycles.
            ServoAlarmError: A servo reports a fault, or was reset.
            RefusedError: A joint does not follow its goal.
            HeldUpError: The program was delayed too long, or too often.
        """
        self.stop_request.raise_if_without_braking()
        try:
            return self._update_measured()
        except HeldUpError:
            if self.restarts >= _MAX_RESTARTS:
                raise
        self.restarts += 1
        self._limits.disarm_watchdog()
        self._limits.invalidate()
        self._limits.set_speed(self._horn_rad_s)
        now_s = self.clock.now_s()
        ticks = self._feedback.measure_ticks()
        self._send(self._gate.pass_reset(ticks))
        self._gate.update_measured(ticks, now_s)
        self._feedback.reset_losses()
        self._cycle_at_s = prepare_servos(
            self._limits, self._health_poller, self.clock, self._horn_rad_s
        )
        measured = self._measured = self._reference = self.measure_positions()
        return measured

    def _update_measured(self) -> Vector:
        now_s, before_s = self.clock.now_s(), self._cycle_at_s
        self._cycle_at_s = now_s
        check_pause(now_s - before_s)
        measured = self._feedback.read()
        if self.lost_joints and now_s - before_s > STALL_S:  # a joint was not read for long
            now_s = self.clock.now_s()
            measured = self._feedback.read()
        # The gap counts from the previous cycle's beginning: whether its goals arrived is unknown.
        self._limits.check_watchdog_gap(self.clock.now_s() - before_s)
        self._gate.update_measured(self._feedback.latest, now_s)  # measured at ``now_s`` or later
        self._check_following(measured)
        self._measured = measured
        if self._health_poller:
            self._health_poller.poll()
        return measured

    def _check_following(self, measured: Vector) -> None:
        """Check that the joints follow their goals; without torque or supply, they cannot.

        Raises:
            ServoAlarmError: Servos have lost their torque, or a servo reports a fault.
            RefusedError: A joint does not follow its goal; the error says if the arm is too heavy.
        """
        try:
            goals = self.goals()
            if self.overload.relaxed_joints:
                # The motion must still end if a joint with a pulled-back goal presses more and
                # more.
                relaxed = np.isin(self.names, self.overload.relaxed_joints)
                goals = np.where(relaxed, self._to_positions(self._undrawn), goals)
            self._following.update(goals, measured)
        except RefusedError as error:
            self._check_torque()
            if self._health_poller:
                self._health_poller.poll_round()
            feed_forward = self.compensator.feed_forward
            if feed_forward is not None:
                heavy = self._following.lagging & feed_forward.overweight(measured)
                if heavy.any():
                    raise overweight_error(
                        [self.names[i] for i in np.flatnonzero(heavy)]
                    ) from error
            raise

    def check_health(self) -> None:
        """Read the telemetry of one servo between two motions, while its torque is on.

        Raises:
            BusError: The servo does not answer.
            ServoAlarmError: The servo reports a fault, has a wrong supply, or was reset.
        """
        if self._health_poller:
            self._health_poller.poll()

    def allowed_advance_s(self, elapsed_s: float) -> float:
        """Return the time by which a motion may advance while its goals stay near the joints."""
        return self._gate.allowed_advance_s(elapsed_s)

    def send_goals(self, positions: Vector, now_s: float, reference: Vector | None = None) -> bool:
        """Send goals (n,), rad or m, through the guard, with steps cut to the allowed length.

        If a joint has no recent position reading, nothing is sent and the arm holds.

        Args:
            positions: The goals.
            now_s: The time, by the clock, for which the goals were computed.
            reference: The reference of the joints (n,); None for the held positions.

        Returns:
            Whether the goals were sent without being cut.

        Raises:
            RefusedError: The guard refuses the goals; nothing was sent.
            ServoAlarmError: A servo has lost its torque; nothing was sent.
        """
        self.stop_request.raise_if_without_braking()
        if self._gate.stale_joints(now_s):
            return False
        self._undrawn = self._to_ticks(positions)
        requested = self.overload.draw_back(self._undrawn, self._feedback.latest)
        goals = self._gate.shorten_goals(requested, now_s)
        try:
            self._send(self._gate.pass_goals(goals, now_s))
        except RegisterAccessError as error:  # a servo without torque accepts no goal
            limp = self._limp_joints()
            if limp:
                raise torque_lost_error(limp) from error
            raise
        references = self._to_ticks(self.reference() if reference is None else reference)
        for warning in self.overload.update(goals, self._feedback.latest, now_s, references):
            self.log_warning(warning)
        return goals == requested

    def log_warning(self, text: str) -> None:
        """Store a warning for the user, and pass it to ``warn``."""
        self.warnings.append(text)
        self.warn(text)

    def _find_power_loss(self, error: BaseException) -> IkservoError | None:
        """Return the error for servos that lost power or torque, or None if that is unknown."""
        if not isinstance(error, (ServoSilentError, ServoAlarmError)):
            return None
        with contextlib.suppress(Exception):
            self._hold_goals()  # healthy servos hold before the checks below
        on = {i: servo.table.torque_enable for i, servo in self._bus.servos.items()}
        markers = {i: self._limits.reset_markers(i, watchdog=False) for i in on}
        try:
            read = self._bus.bulk_read({i: [on[i], *markers[i]] for i in on}, raw=True).values
        except IkservoError:  # the port is lost, so servo states are unknown
            return None
        holds = {i for i, row in read.items() if row[on[i]]}
        telling = [i for i in read if markers[i] or i in holds]  # limp without markers: unknown
        reset = {i for i in telling if not read[i].items() >= markers[i].items()}
        silent = [d.joint for d in self.driven_joints if d.servo_id not in read]
        if len(reset) == len(telling):
            return power_lost_error(self.names, silent, holds=bool(holds))
        joints = {d.servo_id: d.joint for d in self.driven_joints if d.servo_id in read}
        limp = [joint for i, joint in joints.items() if i not in holds]
        caught = [joint for i, joint in joints.items() if i in reset & holds]
        return say_what_fell(error, limp, caught, silent) if holds else None

    def _limp_joints(self) -> list[str]:
        return [
            driven.joint
            for driven in self.driven_joints
            if not self._bus.is_torque_on(driven.servo_id)
        ]

    def hold(self, reason: StopReason) -> None:
        """Latch a stop and hold, until ``acknowledge``; never raises.

        Every joint keeps its goal, which may be slightly ahead of its position. A joint that has an
        alarm or cannot follow gets its position as its goal, so that it stops pressing.
        """
        self.latch_stop(reason)
        self._reference = self._measured
        # These packets have no reply. The first one is sent twice, because one may be lost.
        for step in (self._hold_goals, self._hold_goals, self._limits.broadcast_watchdog_off):
            with contextlib.suppress(Exception):  # each packet is tried even if another one fails
                step()

    def _prepare_streaming(self, speed_rad_s: float | None, profile_rad_s: float | None) -> None:
        horns = self._per_horn_rad.tolist()
        speeds = [driven.speed for driven in self.driven_joints]
        if speed_rad_s is not None:
            speeds = [min(speed_rad_s * h, speed) for h, speed in zip(horns, speeds, strict=True)]
        self._gate.set_speeds(speeds)
        self._following = TrackingMonitor.for_limits(self.driven_joints, speeds)
        self._feedback.reset_losses()
        fastest_rad_s = max(speed / horn for horn, speed in zip(horns, speeds, strict=True))
        self._horn_rad_s, self.restarts = profile_rad_s or fastest_rad_s, 0
        self._cycle_at_s = prepare_servos(
            self._limits, self._health_poller, self.clock, self._horn_rad_s
        )

    def _hold_goals(self) -> None:
        """Send hold goals to the servos with torque; the other servos are not changed."""
        ticks: list[int | None] = []
        rows = zip(self.driven_joints, self._gate.goals, self._gate.measured_ticks, strict=True)
        for driven, goal, measured in rows:
            if goal is None or not self._bus.is_torque_on(driven.servo_id):
                ticks.append(None)
                continue
            at = goal if measured is None else measured
            explained_rad = max(driven.at_rest_lead_rad, _PRESSING_LAG_RAD)
            presses = abs(goal - at) * driven.joint_map.horn_rad_per_tick > explained_rad
            ticks.append(at if presses or self._bus.alarms.get(driven.servo_id) else goal)
        self._send(self._gate.pass_hold(ticks))

    def _send(self, passed: PassedGoals) -> None:
        """Write goals that passed the gate, and commit them."""
        rows = zip(self._ids, passed.ticks, strict=True)
        self._write_goals({servo_id: tick for servo_id, tick in rows if tick is not None})
        self._gate.commit(passed)

    def _write_goals(self, goals: Mapping[int, int]) -> None:
        """Write goals; each is within its limits, or at a tick that was measured or sent before."""
        write_goals(
            self._bus,
            goals,
            self._tick_ranges,
            reached=self._reached,
            describe=lambda servo_id, tick: self.driven_joints[
                self._ids.index(servo_id)
            ].describe_violation(tick),
        )

    def _reached(self, servo_id: int) -> list[int]:
        column = self._ids.index(servo_id)
        known = (self._feedback.latest[column], self._gate.goals[column])
        return [tick for tick in known if tick is not None]

    def _to_ticks(self, positions: Vector) -> list[int]:
        rows = zip(self.driven_joints, positions.tolist(), strict=True)
        return [driven.tick(position) for driven, position in rows]

    def _to_positions(self, ticks: Sequence[int]) -> Vector:
        rows = zip(self.driven_joints, ticks, strict=True)
        return np.array([driven.joint_map.position(tick) for driven, tick in rows])
