"""An arm that runs: torque without a twitch, one motion at a time, stops that stay, and an ear."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace
from threading import RLock, current_thread, main_thread

import numpy as np

from ikservo.arm.background import Background
from ikservo.arm.given import number
from ikservo.arm.lines import Lines
from ikservo.arm.own import serial_number_of, simulated
from ikservo.arm.owner import Listener, listen
from ikservo.arm.owner.answering import Answers
from ikservo.arm.planning import Plan, Planner
from ikservo.arm.reports import JointReport, Whereabouts
from ikservo.arm.skills.poses import Poses
from ikservo.arm.skills.workings import Begin, Workings
from ikservo.arm.streaming.halt import CTRL_C, STOPPED_BY_PROGRAM, StopKind, StopReason
from ikservo.arm.streaming.servos import Servos
from ikservo.arm.streaming.signals import ending, interruptible
from ikservo.arm.streaming.states import JointState
from ikservo.arm.streaming.stream import OnBeat, Stream
from ikservo.arm.streaming.torque_state import TorqueState
from ikservo.arm.trust import Zeros
from ikservo.errors import (
    BadValueError,
    IkservoError,
    PortError,
    RefusedError,
    ServoAlarmError,
    StoppedError,
)
from ikservo.guard import Space
from ikservo.hardware.line.port import Port
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Vector
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
_ENDS_WITHIN_S = 1.0

_LOOK_S = 0.02  # how soon somebody who asks where the arm is learns that it moves


class Running(Lines):
    """What every motion of an ``Arm`` goes through.

    One motion at a time has the turn. A motion that does not end well leaves the arm stopped; the
    first one after torque came on is slow.
    """

    def __init__(
        self,
        model: Model,
        chain: Chain,
        servos: Servos,
        port: Port,
        space: Space | None,
        zeros: Zeros,
    ) -> None:
        self.model, self.chain, self.zeros = model, chain, zeros
        self._servos, self._port, self._space = servos, port, space
        self._planner = Planner(model, chain, servos.names)
        self._closed = False
        self._stream = Stream(servos)
        self._turn = RLock()
        self._background = Background(self, servos.stop_request)
        self._states: tuple[JointState, ...] = ()
        self._listener: Listener | None = None
        self._serial_number = serial_number_of(port.name)
        self.poses = Poses(model, self._serial_number)
        self.workings = Workings(
            model, chain, servos, self._planner, space, zeros, self._drive, self._allowed
        )

    @property
    def port_name(self) -> str:
        """Return the name of the port the arm is on."""
        return self._port.name

    def where(self) -> Whereabouts:
        """Return the measured tip, joints and health.

        While another thread moves the arm, they are those of its last control cycle.
        """
        while not self._turn.acquire(timeout=_LOOK_S):
            moving = self._servos.torque.is_moving
            if moving and self._states and self._stream.beat is not None:
                return self.glimpse()
        try:
            return self._whereabouts(self._servos.states())
        finally:
            self._turn.release()

    def glimpse(self) -> Whereabouts:
        """Return where and how the arm was last heard to be; asks no servo: any thread may look.

        Raises:
            IkservoError: There was none yet.
        """
        beat, states = self._stream.beat, self._states
        if beat is None or not states:
            raise IkservoError("The arm has just started to move.", "Try again.")
        pairs = zip(self._servos.refreshed(states), beat.measured.tolist(), strict=True)
        return self._whereabouts(tuple(replace(state, position_rad=at) for state, at in pairs))

    def listen(self) -> None:
        """Let other terminals of this user stop the arm, relax it and ask where it is."""
        if self._listener is None and not simulated(self._port.name):
            self._listener = listen(self._port.name, Answers(self, self._turn))

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
    def stops_asked(self) -> int:
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
        within_s = number("The wait", within_s)
        if not 0.0 <= within_s < math.inf:
            raise BadValueError("The wait", within_s, "seconds")
        self._check_open()
        with self._turn:
            self._servos.torque.check_idle()
            adapter = "" if simulated(self.port_name) else self._serial_number
            self._servos.reconnect(adapter, within_s)

    def release(self) -> None:
        """Switch every servo's torque off where the arm is; what nobody holds falls.

        A running motion ends with ``StoppedError`` first.

        Raises:
            BusError: A servo does not answer; the torque of all others is off.
        """
        with self._after_motion(*_RELEASED):
            self._servos.release()

    @contextmanager
    def _after_motion(self, reason: StopReason, hint: str) -> Generator[None]:
        """Have the turn, a running motion having been ended without braking.

        Its own callback may want that, and so has the turn already; a motion that does not end is
        not waited for any longer than a second.
        """
        servos = self._servos
        if servos.torque.is_moving:
            servos.stop_request.set_without_braking(reason, hint)
        taken = self._turn.acquire(timeout=_ENDS_WITHIN_S)
        try:
            if servos.torque.is_moving:
                servos.hold(reason)
            yield
        finally:
            if taken:
                self._turn.release()

    @contextmanager
    def _moving(self) -> Generator[None]:
        """Have the turn, torque on and signals heard; after a fault torque is looked at anew."""
        with self._turn:
            self._servos.torque.check_idle()
            stopped = self.stop_reason is not None  # which `enable` refuses
            if stopped or not self._servos.torque.is_on:
                self.enable()
            if self._listener is not None or current_thread() is not main_thread():
                self._states = self._servos.states()
            with self._stopping_well():
                yield
            self._servos.torque.motion_completed()
            self._servos.acknowledge_ended()

    @contextmanager
    def _stopping_well(self) -> Generator[None]:
        request, torque = self._servos.stop_request, self._servos.torque
        try:
            with request.motion(), interruptible(request, lambda: torque.is_moving):
                yield
        except (KeyboardInterrupt, StoppedError) as error:
            torque.faulted()
            self._servos.hold(request.reason or _reason_of(error))
            if isinstance(error, StoppedError) and not request.signal:
                self._servos.acknowledge_ended()
                raise
            raise ending(request.signal, self.stopped_for) from None
        except ServoAlarmError as error:
            torque.faulted()
            self._let_go_of_the_hot(StopReason(StopKind.FAULT, error.message))
            raise
        except BaseException:
            torque.faulted()
            raise

    @abstractmethod
    def _lower(self) -> JointReport:
        """Lower the arm to its rest pose; see ``Arm``."""

    def _let_go_of_the_hot(self, reason: StopReason) -> None:
        """Lower the arm and let it go where a servo is too hot to hold it any longer."""
        servos = self._servos
        if not servos.too_hot or servos.torque.state is TorqueState.LOWERING:
            return
        try:
            servos.acknowledge()
            with servos.bearing_heat():
                self.enable()
            servos.torque.lowering_started()
            self._lower()
            self.release()
        except IkservoError as error:
            servos.warn(f"The arm could not be lowered: {error.message}")
        finally:
            servos.torque.lowering_ended()
            servos.latch_stop(reason)

    def _check_open(self) -> None:
        if self._closed:
            raise PortError(f"{self.port_name} was closed.", "Open the arm again: open_arm().")

    def _drive(self, begin: Begin, on_beat: OnBeat | None, speed: str) -> Vector:
        """Carry out a course that begins where the servos' goals are; see ``Workings``."""
        horn_rad_s = self.model.speed(speed).rad_s
        with self._moving():
            course = begin(self._servos.goals())
            return self._stream.run(course, on_beat, speed_rad_s=horn_rad_s)

    def _whereabouts(self, states: tuple[JointState, ...]) -> Whereabouts:
        joints = np.array([state.position_rad for state in states])
        T = self._planner.tip_pose(joints)
        return Whereabouts(T[:3, 3], states, T[:3, :3])

    def _here(self) -> Vector:
        """Return where a motion starts: the goals of a holding arm, else the measured joints."""
        return self._servos.goals() if self._servos.torque.is_on else self._servos.standing()

    def _allowed(self, speed: str) -> str:
        """Return the speed of a motion that could start now: the first one is slow."""
        self.model.speed(speed)
        return "slow" if self._read_first_motion() else speed

    def _read_first_motion(self) -> bool:
        """Tell whether no motion has completed since torque came on, or it is off.

        Where that is not known the servos are read.
        """
        torque = self._servos.torque
        return torque.first_motion_due or not (torque.is_on or self._servos.read_torque_on())

    def _check_speed(self, plan: Plan) -> None:
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
