"""Whether an arm's servos hold, and what its next motion may be: one state, a transition a reason.

::

    UNKNOWN --enabled--> FIRST_MOTION or HOLDING --loop_started--> MOVING --loop_ended--> back
    FIRST_MOTION --motion_completed--> HOLDING
    any --faulted, acknowledged, reconnected, invalidated, releasing, enabling--> UNKNOWN
    UNKNOWN --released--> OFF
    FIRST_MOTION, HOLDING --lowering_started--> LOWERING --released--> OFF
                                                LOWERING --lowering_ended--> UNKNOWN

What latches a stop is not a state of torque and stays with the gate (``guard.Latch``).
"""

from __future__ import annotations

from enum import Enum, auto

from ikservo.errors import RefusedError

__all__ = ["TorqueState", "TorqueStateMachine"]


class TorqueState(Enum):
    """What is known of the torque of an arm's servos, and what they do with it."""

    UNKNOWN = auto()
    """Not read since the arm was opened, or since a fault, a reconnect or an acknowledge."""
    OFF = auto()
    """Switched off by this program."""
    FIRST_MOTION = auto()
    """On, and no motion has completed since it came on: the next one is slow."""
    HOLDING = auto()
    """On, each servo at its goal."""
    MOVING = auto()
    """On, and a control loop sends goals and looks at the stop request in every cycle."""
    LOWERING = auto()
    """On, while an overheated arm is brought to its rest pose; between two control loops."""


_ON = (TorqueState.FIRST_MOTION, TorqueState.HOLDING, TorqueState.LOWERING)


class TorqueStateMachine:
    """The torque state of one arm.

    Transitions are made by the thread that has the arm's turn; signals and others only read. One
    thing is remembered besides the state: whether a first motion is due. A fault makes the state
    UNKNOWN, but completes no motion, so that the next one is still slow.
    """

    def __init__(self) -> None:
        self._at_rest = TorqueState.UNKNOWN
        self._loop_running = self._first_motion_due = False

    @property
    def state(self) -> TorqueState:
        """The state now."""
        return TorqueState.MOVING if self._loop_running else self._at_rest

    @property
    def is_moving(self) -> bool:
        """Whether a control loop runs, and so will see a stop request in its next cycle."""
        return self._loop_running

    @property
    def is_on(self) -> bool:
        """Whether torque is known to be on and goals are known to be where the joints are."""
        return self._at_rest in _ON

    @property
    def first_motion_due(self) -> bool:
        """Whether no motion has completed since torque came on, as far as is known."""
        return self._first_motion_due

    def check_idle(self) -> None:
        """Raise while a control loop runs.

        Raises:
            RefusedError: One does.
        """
        if self._loop_running:
            raise RefusedError(
                "The arm is moving.", "Wait for the motion's end, or stop it: arm.stop()."
            )

    def enabling(self, *, was_on: bool) -> None:
        """Torque is about to be switched on: until all of it is, nothing is certain.

        Args:
            was_on: Whether every servo had its torque on already.
        """
        self._first_motion_due = self._first_motion_due or not was_on
        self._at_rest = TorqueState.UNKNOWN

    def enabled(self) -> None:
        """Every servo has its torque on, with its goal where it is."""
        due = self._first_motion_due
        self._at_rest = TorqueState.FIRST_MOTION if due else TorqueState.HOLDING

    def loop_started(self) -> None:
        """A control loop begins to send goals.

        Raises:
            RefusedError: One runs already, or torque is not known to be on.
        """
        self.check_idle()
        if not self.is_on:
            raise RefusedError("Torque is not on.", "Switch its torque on first.")
        self._loop_running = True

    def loop_ended(self) -> None:
        """The control loop has sent its last goal, well or not."""
        self._loop_running = False

    def motion_completed(self) -> None:
        """A motion has ended well, after one control loop or several."""
        if self._at_rest in (TorqueState.FIRST_MOTION, TorqueState.HOLDING):
            self._at_rest, self._first_motion_due = TorqueState.HOLDING, False

    def faulted(self) -> None:
        """A motion has failed or was stopped: goals and torque are read before the next one.

        Torque that was switched off in that motion is off, and a lowering goes on to its own end.
        """
        if self._at_rest not in (TorqueState.OFF, TorqueState.LOWERING):
            self._at_rest = TorqueState.UNKNOWN

    def invalidated(self) -> None:
        """Torque shall be enabled anew before the next motion, because that has other limits."""
        self._at_rest = TorqueState.UNKNOWN

    def acknowledged(self) -> None:
        """A user has looked at a stopped arm, and may have done anything to it meanwhile."""
        self._at_rest = TorqueState.UNKNOWN

    def reconnected(self) -> None:
        """The line was lost: the servos may have been without power."""
        self._at_rest, self._first_motion_due = TorqueState.UNKNOWN, True

    def releasing(self) -> None:
        """Torque is about to be switched off: of a servo that does not answer nothing is known."""
        self._at_rest = TorqueState.UNKNOWN

    def released(self) -> None:
        """Torque of every servo is off."""
        self._at_rest, self._first_motion_due = TorqueState.OFF, True

    def lowering_started(self) -> None:
        """An overheated arm is about to be brought to its rest pose.

        Raises:
            RefusedError: Torque is not known to be on.
        """
        if not self.is_on:
            raise RefusedError("Torque is not on.", "Switch its torque on first.")
        self._at_rest = TorqueState.LOWERING

    def lowering_ended(self) -> None:
        """That is over: either torque is off, or the arm could not be brought down."""
        if self._at_rest is TorqueState.LOWERING:
            self._at_rest = TorqueState.UNKNOWN
