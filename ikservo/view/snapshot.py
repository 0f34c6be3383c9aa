"""Values that cross the thread boundary: commands to the arm, snapshots from it.

Each has one writer and is replaced as a whole, so that no thread waits for another.
"""

from __future__ import annotations

from dataclasses import dataclass

from ikservo.arm import JointState
from ikservo.calibration.procedure import CalibrationState
from ikservo.kinematics.arrays import Vector

__all__ = ["ArmCommand", "ArmSnapshot", "CalibrationView", "StopNotice"]


@dataclass(frozen=True, slots=True, eq=False)
class ArmCommand:
    """What the person in control wants; a new one replaces the last.

    Attributes:
        live: Whether the arm shall follow at all.
        session_id: Counts how often Live was thrown; a flight that has ended is not begun again.
        goal: Where all joints shall be (n,), rad or m; None where they are.
        speed: slow, normal or fast.
        heartbeat_s: When the page last showed that somebody is there.
    """

    live: bool = False
    session_id: int = 0
    goal: Vector | None = None
    speed: str = "slow"
    heartbeat_s: float = 0.0


@dataclass(frozen=True, slots=True)
class StopNotice:
    """Why the arm holds until a person acknowledges it, in the words of the command line.

    Attributes:
        message: What happened.
        hint: What to do now.
    """

    message: str
    hint: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationView:
    """A calibration under way.

    Attributes:
        wizard: Where the conversation is; None while the arm still holds itself.
        complaint: Why the last answer did not do.
        warnings: What saving would lose, and what the servos' own limits would cut off.
        saved_at: The file, once it is saved.
    """

    wizard: CalibrationState | None
    complaint: str = ""
    warnings: tuple[str, ...] = ()
    saved_at: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class ArmSnapshot:
    """What the pilot last saw.

    Attributes:
        measured: Where the joints are (n,), rad or m.
        goals: Where the servos were told to go (n,); None while they follow nobody.
        states: What the servos report, a little older.
        trouble: Why the arm holds, if it does.
        ended_session: The last flight that is over.
        notes: What the arm said besides, the oldest first.
        talk: The calibration under way, if any.
    """

    measured: Vector
    goals: Vector | None = None
    states: tuple[JointState, ...] = ()
    trouble: StopNotice | None = None
    ended_session: int = 0
    notes: tuple[str, ...] = ()
    talk: CalibrationView | None = None
