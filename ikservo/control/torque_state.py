"""The torque state of an arm: a state machine with one transition per event.

::

    UNKNOWN --enabled--> FIRST_MOTION or HOLDING --loop_started--> MOVING --loop_ended--> back
    FIRST_MOTION --motion_completed--> HOLDING
    any --faulted, acknowledged, reconnected, invalidated, releasing, enabling--> UNKNOWN
    UNKNOWN --released--> OFF
    FIRST_MOTION, HOLDING --lowering_started--> LOWERING --released--> OFF
                                                LOWERING --lowering_ended--> UNKNOWN

A latched stop is not a torque state; it belongs to the gate (``guard.stop_latch.StopLatch``).
"""

from __future__ import annotations

from enum import Enum, auto

from ikservo.errors import RefusedError


class TorqueState(Enum):
    """The known torque state of an arm's servos."""

    UNKNOWN = auto()
    """Torque was not read since opening, or since a fault, reconnection or acknowledgement."""
    OFF = auto()
    """Torque was switched off by this program."""
    FIRST_MOTION = auto()
    """Torque is on, but no motion has been completed since it came on; the next one is slow."""
    HOLDING = auto()
    """Torque is on, and each servo is at its goal."""
    MOVING = auto()
    """Torque is on, and a control loop sends goals and checks stop requests in every cycle."""
    LOWERING = auto()
    """Torque is on while an overheated arm is lowered to its rest pose, between control loops."""


_ON = (TorqueState.FIRST_MOTION, TorqueState.HOLDING, TorqueState.LOWERING)


class TorqueStateMachine:
    """The torque state of one arm.

    The thread that holds the runner's lock makes transitions; signals and other threads only read.
    The state machine also remembers that a first motion is due: a fault makes the state UNKNOWN but
    completes no motion, so the next motion is still slow.
    """

    def __init__(self) -> None:
        self._at_rest = TorqueState.UNKNOWN
        self._loop_running = self._first_motion_due = False

    @property
    def state(self) -> TorqueState:
        """The present state."""
        return TorqueState.MOVING if self._loop_running else self._at_rest

    @property
    def is_moving(self) -> bool:
        """Whether a control loop is running, which will handle a stop request in its next cycle."""
        return self._loop_running

    @property
    def is_on(self) -> bool:
        """Whether torque is known to be on and goals are known to match the joints."""
        return self._at_rest in _ON

    @property
    def is_off(self) -> bool:
        """Whether torque of every servo is known to be off."""
        return self._at_rest is TorqueState.OFF

    @property
    def first_motion_due(self) -> bool:
        """Whether no motion has completed since torque came on, as far as known."""
        return self._first_motion_due

    def check_idle(self) -> None:
        """Check that no control loop is running.

        Raises:
            RefusedError: A control loop is running.
        """
        if self._loop_running:
            raise RefusedError(
                "The arm is moving.", "Wait until the motion has ended, or stop it: arm.stop()."
            )

    def enabling(self, *, was_on: bool) -> None:
        """Record that torque is about to come on; it is unknown until all servos have torque."""
        self._first_motion_due = self._first_motion_due or not was_on
        self._at_rest = TorqueState.UNKNOWN

    def enabled(self) -> None:
        """Record that every servo has torque, with its goal at its position."""
        due = self._first_motion_due
        self._at_rest = TorqueState.FIRST_MOTION if due else TorqueState.HOLDING

    def loop_started(self) -> None:
        """Record that a control loop starts to send goals.

        Raises:
            RefusedError: A loop is already running, or torque is not known to be on.
        """
        self.check_idle()
        if not self.is_on:
            raise RefusedError("Torque is not on.", "Switch its torque on first.")
        self._loop_running = True

    def loop_ended(self) -> None:
        """Record that the control loop has sent its last goal, after success or a fault."""
        self._loop_running = False

    def motion_completed(self) -> None:
        """Record that a motion has completed, after one or several control loops."""
        if self._at_rest in (TorqueState.FIRST_MOTION, TorqueState.HOLDING):
            self._at_rest, self._first_motion_due = TorqueState.HOLDING, False

    def faulted(self) -> None:
        """Record that a motion failed or was stopped; goals and torque are then read again.

        If torque was switched off in that motion it stays off, and a lowering continues to its end.
        """
        if self._at_rest not in (TorqueState.OFF, TorqueState.LOWERING):
            self._at_rest = TorqueState.UNKNOWN

    def invalidated(self) -> None:
        """Require torque to be enabled again before the next motion, because limits changed."""
        self._at_rest = TorqueState.UNKNOWN

    def acknowledged(self) -> None:
        """Record that a stop was acknowledged; the arm may have been changed meanwhile."""
        self._at_rest = TorqueState.UNKNOWN

    def reconnected(self) -> None:
        """Record that the port was lost, and the servos may have been without power."""
        self._at_rest, self._first_motion_due = TorqueState.UNKNOWN, True

    def releasing(self) -> None:
        """Record that torque is about to go off; it is unknown if a servo does not reply."""
        self._at_rest = TorqueState.UNKNOWN

    def released(self) -> None:
        """Record that torque of every servo is off."""
        self._at_rest, self._first_motion_due = TorqueState.OFF, True

    def lowering_started(self) -> None:
        """Record that an overheated arm is about to be lowered to its rest pose.

        Raises:
            RefusedError: Torque is not known to be on.
        """
        if not self.is_on:
            raise RefusedError("Torque is not on.", "Switch its torque on first.")
        self._at_rest = TorqueState.LOWERING

    def lowering_ended(self) -> None:
        """Record that lowering has ended because torque is off or the arm could not be lowered."""
        if self._at_rest is TorqueState.LOWERING:
            self._at_rest = TorqueState.UNKNOWN
