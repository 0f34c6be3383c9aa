"""Values that cross the thread boundary: commands to the arm thread, snapshots from it.

Each value has one writer and is replaced as a whole, so that no thread waits for another.
"""

from __future__ import annotations

from dataclasses import dataclass

from ikservo.apps.calibrating.by_hand_procedure import CalibrationStage
from ikservo.arm import JointState
from ikservo.kinematics.arrays import Vector
from ikservo.maintenance.dialogue import HandRequest, Progress, Question


@dataclass(frozen=True, slots=True, eq=False)
class ArmCommand:
    """The command from the client in control; a new command replaces the last one.

    Attributes:
        live: Whether the arm follows the goal.
        session_id: Counts how often Live was switched on; an ended session is not started again.
        goal: Goal of all joints (n,), rad or m; None to hold position.
        by_tip: Whether the goal was found for a target of the tip.
        speed: slow, normal or fast.
    """

    live: bool = False
    session_id: int = 0
    goal: Vector | None = None
    by_tip: bool = False
    speed: str = "slow"


@dataclass(frozen=True, slots=True)
class LogEntry:
    """A message for the user.

    Attributes:
        time_s: The time, by the clock of the page.
        message: The text of the message.
        level: ``bad`` for a problem, empty for information.
    """

    time_s: float
    message: str
    level: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class GoalRefusal:
    """A goal that the guard refuses.

    Attributes:
        goal: Goal of all joints (n,), the array that was refused.
        reason: The reason, in one sentence.
        pair: The two parts that would touch: a link, and another link or a thing; empty without a
            contact.
        kept: The goal (n,) that the arm keeps; None if it does not move.
    """

    goal: Vector
    reason: str
    pair: tuple[str, ...] = ()
    kept: Vector | None = None


@dataclass(frozen=True, slots=True)
class StopNotice:
    """The reason for a stop that a user must acknowledge, formatted as on the command line."""

    message: str
    hint: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationView:
    """A running calibration.

    Attributes:
        item: The question or request, or what the arm does by itself.
        request: The last request, with its reading; None while torque is still on.
        lines: The lines since the last answer.
        number: The number of the screen, from 1; an answer names its screen.
    """

    item: HandRequest | Question | Progress
    request: HandRequest | None = None
    lines: tuple[str, ...] = ()
    number: int = 0

    @property
    def stage(self) -> str:
        """The part of the calibration; an arm that moves itself is in its sweep."""
        return (not isinstance(self.item, Progress) and self.item.stage) or CalibrationStage.SWEEP


@dataclass(frozen=True, slots=True, eq=False)
class ArmSnapshot:
    """The state of the arm, as the arm thread last read it.

    Attributes:
        measured: Measured joint positions (n,), rad or m.
        start: The joints (n,) at which a motion would start now.
        read_s: The time of the measurement.
        reference: The reference of the joints (n,); None while no session runs.
        states: Telemetry of the servos, a little older than the positions.
        stop_notice: The reason why the arm holds; None if it is not stopped.
        stop_count: Number of completed stops; confirms them to the page.
        ended_session: The last session that has ended.
        refusal: The last goal that was refused in a session; None if there is none.
        messages: Messages for the user, the oldest first.
        calibration: The running calibration, if any.
        activity: The running job and the time of its present motion; None if no job is running.
    """

    measured: Vector
    start: Vector
    read_s: float = 0.0
    reference: Vector | None = None
    states: tuple[JointState, ...] = ()
    stop_notice: StopNotice | None = None
    stop_count: int = 0
    ended_session: int = 0
    refusal: GoalRefusal | None = None
    messages: tuple[LogEntry, ...] = ()
    calibration: CalibrationView | None = None
    activity: Progress | None = None
