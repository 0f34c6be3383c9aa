"""Runner of motions, which handles torque, stops, faults and states for all threads."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Generator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from functools import partial
from threading import RLock, current_thread, main_thread

import numpy as np

from ikservo.arguments import parse_number
from ikservo.arm.background_motion import check_not_forked
from ikservo.control.joint_reading import JointState
from ikservo.control.loop import ControlLoop, OnCycle
from ikservo.control.stop_requests import (
    CTRL_C,
    StopOutcome,
    exit_exception,
    handle_signals,
)
from ikservo.control.torque_state import TorqueState
from ikservo.errors import (
    BadValueError,
    IkservoError,
    PortError,
    RefusedError,
    ServoAlarmError,
    StoppedError,
)
from ikservo.guard import StopKind, StopReason
from ikservo.hardware.port_names import is_simulated
from ikservo.kinematics.arrays import Vector
from ikservo.motion import Trajectory
from ikservo.planning.context import ArmContext
from ikservo.planning.reports import ArmState

_CLOSED = (
    StopReason(StopKind.CLOSED, "The program closed the arm during a motion."),
    "The arm holds its position. Open it again to move it.",
)
_RELEASED = (
    StopReason(StopKind.RELEASED, "The program switched torque off during a motion."),
    "Torque is off. Acknowledge the stop first.",
)
_STOP_TIMEOUT_S = 1.0
_POLL_PERIOD_S = 0.02  # time in which ``state`` in another thread notices a motion

TrajectoryFactory = Callable[[Vector], Trajectory]
"""Function that makes a trajectory from the joint positions (n,), rad or m."""


class MotionRunner:
    """Runner of every motion of an arm, one at a time under ``lock``.

    A motion that fails leaves the arm stopped; the first motion after torque comes on is slow.

    Attributes:
        loop: Streams trajectories to the servos.
        watches_scene: Whether the scene may change, because the motion checks its path again.
        caches_states: Whether joint states are read before each motion for ``last_state``, even if
            the motion runs in the main thread.
        on_overheat: Switches torque off if a motion failed and a servo is too hot to continue
            holding.
    """

    def __init__(self, context: ArmContext) -> None:
        self._context = context
        self._servos = context.servos
        self._lock = RLock()
        self._process_id = os.getpid()
        self._closed = False
        self._states: tuple[JointState, ...] = ()
        self.loop = ControlLoop(context.servos)
        self.caches_states = self.watches_scene = False
        self.on_overheat: Callable[[], object] = self.disable_torque

    @property
    def lock(self) -> RLock:
        """The lock that a motion holds.

        Raises:
            RefusedError: This process is a fork of the process that opened the arm.
        """
        check_not_forked(self._process_id)
        return self._lock

    @property
    def motion_running(self) -> bool:
        """Whether a motion is running, in one or several control loops."""
        return self._servos.stop_request.motion_running

    @property
    def stop_requests(self) -> int:
        """Number of stop requests since the last ``acknowledge``."""
        return self._servos.stop_request.times

    @property
    def stop_reason(self) -> StopReason | None:
        """The reason for the stop, until it is acknowledged; None if the arm is not stopped."""
        return self._servos.stop_reason

    @property
    def stop_text(self) -> str:
        """The text of ``stop_reason``; empty if the arm is not stopped."""
        return "" if self.stop_reason is None else self.stop_reason.text

    def state(self) -> ArmState:
        """Measure the joints, the tip and the servos' health.

        While another thread moves the arm, the values are those of its last control cycle.
        """
        locked = self.lock.acquire(blocking=False)
        while not locked:
            moving = self._servos.torque.is_moving
            if moving and self._states and self.loop.last_cycle is not None:
                return self.last_state()
            locked = self.lock.acquire(timeout=_POLL_PERIOD_S)
        try:
            return self._make_arm_state(self._servos.read_states())
        finally:
            self.lock.release()

    def last_state(self) -> ArmState:
        """Return the state of the last control cycle; reads no servo and is safe in any thread.

        Raises:
            IkservoError: There is no state yet.
        """
        cycle, states = self.loop.last_cycle, self._states
        if cycle is None or not states:
            raise IkservoError("The arm has just started to move.", "Try again.")
        latest = self._servos.with_latest_telemetry(states)
        pairs = zip(latest, cycle.measured.tolist(), strict=True)
        return self._make_arm_state(tuple(replace(state, position_rad=at) for state, at in pairs))

    def enable(self) -> None:
        """Switch torque on; each servo's goal is set to its position first.

        Raises:
            RefusedError: A motion is running.
        """
        with self.lock:
            self._servos.torque.check_idle()
            self._servos.stop_request.check_request()
            if self._servos.torque.is_off:
                self._context.surroundings.contacts = None
            self._servos.enable(self._context.model.speed("slow").rad_s)
            self.loop.measure_cycle_time_s()  # after torque-on: a limp arm would sink

    def disable_torque(self) -> None:
        """Switch every servo's torque off; a running motion ends with ``StoppedError`` first.

        Raises:
            BusError: A servo does not answer; the torque of all others is off.
        """
        with self._after_motion(*_RELEASED):
            self._servos.disable_torque()

    def set_joint_torque(self, joint: str, *, on: bool) -> None:
        """Switch one joint's torque on, with its goal at its position, or off.

        Nothing moves at switch-on. A joint without torque falls, with everything that it carries.

        Raises:
            RefusedError: A motion is running, or a stop was not acknowledged.
            UnknownNameError: There is no such joint.
        """
        with self.lock:
            self._servos.torque.check_idle()
            self._context.index.column(joint)
            if on:
                self._servos.enable_joint(joint, self._context.model.speed("slow").rad_s)
            else:
                self._servos.disable_joint(joint)

    def requested(self) -> AbstractContextManager[None]:
        """Treat this thread's actions in the ``with`` block as one request, which a stop ends.

        This also holds if the stop is acknowledged before the block has ended.
        """
        check_not_forked(self._process_id)
        return self._servos.stop_request.requested()

    @contextmanager
    def undisturbed(self) -> Generator[None]:
        """Keep other threads from moving this arm or an arm in reach, and from changing the scene.

        A stop ends all actions in the ``with`` block, as in ``requested``.

        Raises:
            RefusedError: Another arm in reach is moving.
        """
        with self.requested(), self.lock, self._context.surroundings.undisturbed():
            yield

    def request_stop(self, reason: StopReason) -> None:
        """Brake the running motion and hold; safe from signals and other threads."""
        check_not_forked(self._process_id)
        self.loop.request_stop(reason)

    def acknowledge(self) -> None:
        """Acknowledge a stop, so that the arm may be moved again."""
        check_not_forked(self._process_id)
        self._servos.acknowledge()

    def stop_servos(self, reason: StopReason) -> StopOutcome:
        """Latch a stop and hold the measured positions, while no motion runs."""
        return self._servos.hold_measured(reason)

    def latch_stop(self, reason: StopReason) -> None:
        """Refuse motions until ``acknowledge``; nothing is sent to the servos."""
        self._servos.latch_stop(reason)

    def reconnect(self, within_s: float) -> None:
        """Open the port again once its USB adapter is back; see ``Arm.reconnect``."""
        within_s = parse_number("The wait", within_s)
        if not 0.0 <= within_s < math.inf:
            raise BadValueError("The wait", within_s, "a number of seconds")
        self.check_open()
        with self.lock:
            self._servos.torque.check_idle()
            adapter = "" if is_simulated(self._context.port.name) else self._context.serial_number
            self._servos.reconnect(adapter, within_s)

    def check_open(self) -> None:
        """Check that the arm was not closed.

        Raises:
            PortError: The arm was closed.
        """
        if self._closed:
            raise PortError(
                f"{self._context.port.name} was closed.", "Open the arm again: open_arm()."
            )

    def close(self, relax: Callable[[], object] | None, leave: Callable[[], None]) -> None:
        """Close the port; another thread's motion ends with ``StoppedError`` first.

        A forked child of the process that opened the arm closes no port and relaxes nothing.

        Args:
            relax: Lowers the arm before the port is closed; None leaves torque unchanged.
            leave: Tells other arms the final position of this one, and ends services for other
                processes.

        Raises:
            RefusedError: A callback of the arm's motion tried to relax and close the arm.
        """
        if os.getpid() != self._process_id:
            self._closed = True
            return
        if relax:
            with self.lock:
                self._servos.torque.check_idle()
        try:
            if relax:
                relax()
        finally:
            self._closed = True
            with self._after_motion(*_CLOSED):
                pass
            leave()
            with self.lock:  # not while another process relaxes the arm
                self._context.port.close()

    @contextmanager
    def motion(self) -> Generator[None]:
        """Hold the lock for one motion, with torque on, signals handled and faults latched.

        Raises:
            RefusedError: Another motion of this arm or of an arm in reach is running, or a stop was
                not acknowledged.
            StoppedError: The arm was stopped after the motion was requested.
        """
        with self.undisturbed():
            torque = self._servos.torque
            torque.check_idle()
            self._servos.stop_request.check_request()
            stopped = self.stop_reason is not None  # which `enable` refuses
            if stopped or not torque.is_on:
                self.enable()
            else:
                self._servos.refresh_reference()
            self._context.note_contacts(self._servos.reference())
            if self.caches_states or current_thread() is not main_thread():
                self._states = self._servos.read_states()
            with self._stop_on_error():
                yield
            torque.motion_completed()
            self._servos.acknowledge_ended()

    @contextmanager
    def watching_scene(self) -> Generator[None]:
        """Let other threads change the things around the arm during the ``with`` block's motion."""
        self.watches_scene = True
        try:
            yield
        finally:
            self.watches_scene = False

    def run(
        self,
        make: TrajectoryFactory,
        on_cycle: OnCycle | None,
        speed: str,
        *,
        profile_rad_s: float | None = None,
        compensated: bool = True,
    ) -> Vector:
        """Run one trajectory as a motion.

        Args:
            make: Makes the trajectory from the joint positions, with torque on.
            on_cycle: Called in every control cycle.
            speed: slow, normal or fast.
            profile_rad_s: See ``ControlLoop.run``.
            compensated: See ``ControlLoop.run``; if False, the trajectory starts at the servos'
                goals.

        Returns:
            The measured joints (n,) of the last control cycle, rad or m.
        """
        horn_rad_s = self._context.model.speed(speed).rad_s
        with self.motion():
            start = self._servos.reference() if compensated else self._servos.goals()
            return self.loop.run(
                make(start),
                on_cycle,
                speed_rad_s=horn_rad_s,
                profile_rad_s=profile_rad_s,
                compensated=compensated,
            )

    def return_within_limits(self) -> None:
        """Slowly move joints that are slightly outside their limits back inside.

        A limp arm may sink beyond its limits. Online trajectories must start inside, because the
        guard lets a joint return, but not move out again by even one tick.

        Raises:
            RefusedError: A joint is more than 5° outside at its horn, or the arm would touch
                something on its path back.
        """
        lower, upper = self._context.limits()
        check_not_forked(self._process_id)
        measured = self._servos.measure_positions()
        if ((measured >= lower) & (measured <= upper)).all():
            return
        from ikservo.planning.return_within_limits import plan_return  # noqa: PLC0415  # rarely

        plan_return(self._context, measured)  # before torque comes on
        self.run(partial(plan_return, self._context), None, "slow")

    def start_position(self) -> Vector:
        """Return the start (n,) of a motion, rad or m; a limp arm is measured."""
        check_not_forked(self._process_id)
        if self._servos.torque.is_on:
            return self._servos.reference()
        return self._servos.measured_hold_positions()

    def allowed_speed(self, speed: str) -> str:
        """Return the speed class of a motion that starts now; the first motion is slow.

        Raises:
            UnknownNameError: There is no such speed.
        """
        self._context.model.speed(speed)
        return "slow" if self._read_first_motion() else speed

    def check_speed(self, speed: str) -> None:
        """Check that a planned speed class is still allowed.

        Raises:
            RefusedError: Torque was switched off after the motion was planned.
        """
        if speed != "slow" and self._read_first_motion():
            raise RefusedError(
                "Torque was switched off after this motion was planned.",
                "Nothing was sent. Plan again: the first motion after torque-on is slow.",
            )

    def _read_first_motion(self) -> bool:
        """Check whether torque is off, or no motion has been completed since torque came on.

        Servos are read if this is not known.
        """
        torque = self._servos.torque
        return torque.first_motion_due or not (torque.is_on or self._servos.read_torque_on())

    @contextmanager
    def _after_motion(self, reason: StopReason, hint: str) -> Generator[None]:
        """End a running motion without braking, then hold the lock.

        A callback of that motion, which already holds the lock, may also call this function. If the
        motion does not end, the wait takes at most one second.
        """
        servos = self._servos
        if servos.torque.is_moving:
            servos.stop_request.set_without_braking(reason, hint)
        locked = self.lock.acquire(timeout=_STOP_TIMEOUT_S)
        try:
            if servos.torque.is_moving:
                servos.hold(reason)
            yield
        finally:
            if locked:
                self._lock.release()

    @contextmanager
    def _stop_on_error(self) -> Generator[None]:
        request, torque = self._servos.stop_request, self._servos.torque
        begun = False
        try:
            with request.motion(), handle_signals(request, lambda: torque.is_moving):
                request.check_request()  # from here on a stop is acknowledged at the motion's end
                begun = True
                yield
        except (KeyboardInterrupt, StoppedError) as error:
            if not begun and isinstance(error, StoppedError):
                self._servos.acknowledge_ended()
                raise
            torque.faulted()
            reason = CTRL_C  # unless a callback raised a stop without a request
            if isinstance(error, StoppedError):
                reason = StopReason(StopKind.PROGRAM, error.message)
            self._servos.hold(request.reason or reason)
            if isinstance(error, StoppedError) and not request.signal:
                self._servos.acknowledge_ended()
                raise
            raise exit_exception(request.signal, self.stop_text) from None
        except ServoAlarmError as error:
            torque.faulted()
            self._lower_overheated(StopReason(StopKind.FAULT, error.message))
            raise
        except BaseException:
            torque.faulted()
            raise

    def _lower_overheated(self, reason: StopReason) -> None:
        """Lower the arm and switch torque off if a servo is too hot to continue holding."""
        servos = self._servos
        if not servos.overheated or servos.torque.state is TorqueState.LOWERING:
            return
        try:
            servos.acknowledge()
            with servos.tolerate_heat(), servos.stop_request.requested(anew=True):
                self.enable()
            servos.torque.lowering_started()
            with servos.stop_request.requested(anew=True):
                self.on_overheat()
            self.disable_torque()
        except IkservoError as error:
            servos.log_warning(f"The arm could not be lowered: {error.message}")
        finally:
            servos.torque.lowering_ended()
            servos.latch_stop(reason)

    def _make_arm_state(self, states: tuple[JointState, ...]) -> ArmState:
        T = self._context.planner.tip_pose(np.array([state.position_rad for state in states]))
        if self._servos.torque.is_on:
            pairs = zip(states, self._servos.goals().tolist(), strict=True)
            states = tuple(replace(state, goal_rad=goal) for state, goal in pairs)
        return ArmState(T[:3, 3], states, T[:3, :3])
