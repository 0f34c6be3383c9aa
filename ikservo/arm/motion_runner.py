"""Runs trajectories: enables torque safely, one motion at a time, latched stops."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace
from threading import RLock, current_thread, main_thread

import numpy as np

from ikservo.arm.arguments import parse_number
from ikservo.arm.arm_lines import Lines
from ikservo.arm.background_motion import Background
from ikservo.arm.calibrated_arm import is_simulated, serial_number_of
from ikservo.arm.context import ArmContext, TrajectoryFactory
from ikservo.arm.control_server import CommandHandler, ControlServer, serve
from ikservo.arm.plan import MotionPlan
from ikservo.arm.planner import Planner
from ikservo.arm.poses import PoseLibrary
from ikservo.arm.reports import ArmState, JointMoveResult
from ikservo.arm.zeros import ZeroSource
from ikservo.control.feedback import JointState
from ikservo.control.loop import ControlLoop, OnCycle
from ikservo.control.servo_group import ServoGroup
from ikservo.control.stopping import CTRL_C, STOPPED_BY_PROGRAM, exit_exception, handle_signals
from ikservo.control.torque_state import TorqueState
from ikservo.errors import (
    BadValueError,
    IkservoError,
    PortError,
    RefusedError,
    ServoAlarmError,
    StoppedError,
)
from ikservo.guard import CollisionChecker, StopKind, StopReason
from ikservo.hardware.port import Port
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Vector
from ikservo.model import Model

__all__ = ["CLOSED", "Running"]

CLOSED = (
    StopReason(StopKind.CLOSED, "The program closed the arm during a motion."),
    "It holds. Open it again to move it.",
)
_RELEASED = (
    StopReason(StopKind.RELEASED, "The program switched torque off during a motion."),
    "Torque is off. Acknowledge first.",
)
_STOP_TIMEOUT_S = 1.0

_POLL_PERIOD_S = 0.02  # how soon somebody who asks where the arm is learns that it moves


class Running(Lines):
    """What every motion of an ``Arm`` goes through.

    One motion at a time has the turn. A motion that does not end well leaves the arm stopped; the
    first one after torque came on is slow.
    """

    def __init__(
        self,
        model: Model,
        chain: Chain,
        servos: ServoGroup,
        port: Port,
        space: CollisionChecker | None,
        zeros: ZeroSource,
    ) -> None:
        self.model, self.chain, self.zeros = model, chain, zeros
        self._servos, self._port, self._space = servos, port, space
        self._planner = Planner(model, chain, servos.names)
        self._closed = False
        self._stream = ControlLoop(servos)
        self._turn = RLock()
        self._background = Background(self, servos.stop_request)
        self._states: tuple[JointState, ...] = ()
        self._listener: ControlServer | None = None
        self._serial_number = serial_number_of(port.name)
        self.poses = PoseLibrary(model, self._serial_number)
        self.workings = ArmContext(
            model,
            chain,
            servos,
            self._planner,
            space,
            zeros,
            self._run_trajectory,
            self._allowed_speed,
        )

    @property
    def port_name(self) -> str:
        """Return the name of the port the arm is on."""
        return self._port.name

    def where(self) -> ArmState:
        """Return the measured tip, joints and health.

        While another thread moves the arm, they are those of its last control cycle.
        """
        while not self._turn.acquire(timeout=_POLL_PERIOD_S):
            moving = self._servos.torque.is_moving
            if moving and self._states and self._stream.last_cycle is not None:
                return self.last_state()
        try:
            return self._make_arm_state(self._servos.read_states())
        finally:
            self._turn.release()

    def last_state(self) -> ArmState:
        """Return where and how the arm was last heard to be; asks no servo: any thread may look.

        Raises:
            IkservoError: There was none yet.
        """
        beat, states = self._stream.last_cycle, self._states
        if beat is None or not states:
            raise IkservoError("The arm has just started to move.", "Try again.")
        pairs = zip(self._servos.with_latest_telemetry(states), beat.measured.tolist(), strict=True)
        return self._make_arm_state(tuple(replace(state, position_rad=at) for state, at in pairs))

    def listen(self) -> None:
        """Let other terminals of this user stop the arm, relax it and ask where it is."""
        if self._listener is None and not is_simulated(self._port.name):
            self._listener = serve(self._port.name, CommandHandler(self, self._turn))

    def enable(self) -> None:
        """Let every servo hold where it is; goals are set before torque, so nothing twitches.

        Raises:
            RefusedError: A motion is running; ``stop`` ends it.
        """
        with self._turn:
            self._servos.torque.check_idle()
            self._servos.enable(self.model.speed("slow").rad_s)

    def hold(self) -> None:
        """Let every servo hold where it is now: another name of ``enable``."""
        self.enable()

    def stop(self, reason: str = "") -> None:
        """Brake the running motion within 0.3 s and hold; safe from signals and other threads.

        The motion ends with ``StoppedError``; nothing moves again before ``acknowledge``.
        """
        text = str(reason) or STOPPED_BY_PROGRAM.text
        self.request_stop(StopReason(StopKind.PROGRAM, text))

    def request_stop(self, reason: StopReason) -> None:
        """Stop as ``stop`` does, for a reason of any kind."""
        self._stream.request_stop(reason)

    @property
    def stop_requests(self) -> int:
        """Return how often a stop was asked for since the last ``acknowledge``."""
        return self._servos.stop_request.times

    @property
    def stop_reason(self) -> StopReason | None:
        """Why the arm was stopped until somebody acknowledges it; None where it is not."""
        return self._servos.stop_reason

    @property
    def stopped_for(self) -> str:
        """The text of ``stop_reason``; empty where the arm is not stopped."""
        reason = self.stop_reason
        return "" if reason is None else reason.text

    def acknowledge(self) -> None:
        """End a stop: a person has looked, and the arm may be moved again; nothing moves yet."""
        self._servos.acknowledge()

    def reconnect(self, within_s: float = 10.0) -> None:
        """Go on after the cable was pulled, once the same adapter is plugged in; moves nothing.

        The arm stays stopped until ``acknowledge``; its servos may have been without power, so that
        torque is looked at anew and the first motion is slow.

        Args:
            within_s: How long to wait for the adapter; it is known by its USB serial number.

        Raises:
            BadValueError: The wait is no number of seconds.
            PortLostError: It did not come back in time.
            ServoSilentError: It is back, but its servos do not answer.
            RefusedError: A motion is running.
        """
        within_s = parse_number("The wait", within_s)
        if not 0.0 <= within_s < math.inf:
            raise BadValueError("The wait", within_s, "seconds")
        self._check_open()
        with self._turn:
            self._servos.torque.check_idle()
            adapter = "" if is_simulated(self.port_name) else self._serial_number
            self._servos.reconnect(adapter, within_s)

    def disable_torque(self) -> None:
        """Switch every servo's torque off where the arm is; what nobody holds falls.

        A running motion ends with ``StoppedError`` first.

        Raises:
            BusError: A servo does not answer; the torque of all others is off.
        """
        with self._after_motion(*_RELEASED):
            self._servos.disable_torque()

    @contextmanager
    def _after_motion(self, reason: StopReason, hint: str) -> Generator[None]:
        """Have the turn, a running motion having been ended without braking.

        Its own callback may want that, and so has the turn already; a motion that does not end is
        not waited for any longer than a second.
        """
        servos = self._servos
        if servos.torque.is_moving:
            servos.stop_request.set_without_braking(reason, hint)
        taken = self._turn.acquire(timeout=_STOP_TIMEOUT_S)
        try:
            if servos.torque.is_moving:
                servos.hold(reason)
            yield
        finally:
            if taken:
                self._turn.release()

    @contextmanager
    def _motion_turn(self) -> Generator[None]:
        """Have the turn, torque on and signals heard; after a fault torque is looked at anew."""
        with self._turn:
            self._servos.torque.check_idle()
            stopped = self.stop_reason is not None  # which `enable` refuses
            if stopped or not self._servos.torque.is_on:
                self.enable()
            if self._listener is not None or current_thread() is not main_thread():
                self._states = self._servos.read_states()
            with self._stop_on_error():
                yield
            self._servos.torque.motion_completed()
            self._servos.acknowledge_ended()

    @contextmanager
    def _stop_on_error(self) -> Generator[None]:
        request, torque = self._servos.stop_request, self._servos.torque
        try:
            with request.motion(), handle_signals(request, lambda: torque.is_moving):
                yield
        except (KeyboardInterrupt, StoppedError) as error:
            torque.faulted()
            self._servos.hold(request.reason or _reason_of(error))
            if isinstance(error, StoppedError) and not request.signal:
                self._servos.acknowledge_ended()
                raise
            raise exit_exception(request.signal, self.stopped_for) from None
        except ServoAlarmError as error:
            torque.faulted()
            self._release_overheated(StopReason(StopKind.FAULT, error.message))
            raise
        except BaseException:
            torque.faulted()
            raise

    @abstractmethod
    def _lower(self) -> JointMoveResult:
        """Lower the arm to its rest pose; see ``Arm``."""

    def _release_overheated(self, reason: StopReason) -> None:
        """Lower the arm and let it go where a servo is too hot to hold it any longer."""
        servos = self._servos
        if not servos.overheated or servos.torque.state is TorqueState.LOWERING:
            return
        try:
            servos.acknowledge()
            with servos.tolerate_heat():
                self.enable()
            servos.torque.lowering_started()
            self._lower()
            self.disable_torque()
        except IkservoError as error:
            servos.warn(f"The arm could not be lowered: {error.message}")
        finally:
            servos.torque.lowering_ended()
            servos.latch_stop(reason)

    def _check_open(self) -> None:
        if self._closed:
            raise PortError(f"{self.port_name} was closed.", "Open the arm again: open_arm().")

    def _run_trajectory(
        self, begin: TrajectoryFactory, on_cycle: OnCycle | None, speed: str
    ) -> Vector:
        """Carry out a course that begins where the servos' goals are; see ``ArmContext``."""
        horn_rad_s = self.model.speed(speed).rad_s
        with self._motion_turn():
            course = begin(self._servos.goals())
            return self._stream.run(course, on_cycle, speed_rad_s=horn_rad_s)

    def _make_arm_state(self, states: tuple[JointState, ...]) -> ArmState:
        joints = np.array([state.position_rad for state in states])
        T = self._planner.tip_pose(joints)
        return ArmState(T[:3, 3], states, T[:3, :3])

    def _start_joints(self) -> Vector:
        """Return where a motion starts: the goals of a holding arm, else the measured joints."""
        return (
            self._servos.goals()
            if self._servos.torque.is_on
            else self._servos.measured_hold_positions()
        )

    def _allowed_speed(self, speed: str) -> str:
        """Return the speed of a motion that could start now: the first one is slow."""
        self.model.speed(speed)
        return "slow" if self._read_first_motion() else speed

    def _read_first_motion(self) -> bool:
        """Tell whether no motion has completed since torque came on, or it is off.

        Where that is not known the servos are read.
        """
        torque = self._servos.torque
        return torque.first_motion_due or not (torque.is_on or self._servos.read_torque_on())

    def _check_speed(self, plan: MotionPlan) -> None:
        if plan.speed != "slow" and self._read_first_motion():
            raise RefusedError(
                "Torque was switched off after this was planned.",
                "Nothing was sent. Plan again: the first motion after torque-on is slow.",
            )


def _reason_of(error: KeyboardInterrupt | StoppedError) -> StopReason:
    """Tell for what reason a motion ended that no stop was requested for: a callback raised it."""
    if isinstance(error, StoppedError):
        return StopReason(StopKind.PROGRAM, error.message)
    return CTRL_C
