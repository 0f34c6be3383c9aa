"""What passes between the desk and the pilot: wishes one way, what was seen the other way.

Each has one writer and is replaced as a whole, so that no thread waits for another.
"""

from __future__ import annotations

from dataclasses import dataclass

from ikservo.arm import JointState
from ikservo.calibration.sweeping.sweep import Wizard
from ikservo.kinematics.se3 import Vector

__all__ = ["Readout", "Talk", "Trouble", "Wish"]


@dataclass(frozen=True, slots=True, eq=False)
class Wish:
    """What the person in control wants; a new one replaces the last.

    Attributes:
        live: Whether the arm shall follow at all.
        flight: Counts how often Live was thrown; a flight that has ended is not begun again.
        goal: Where all joints shall be (n,), rad or m; None where they are.
        speed: slow, normal or fast.
        fresh_s: When the page last showed that somebody is there.
    """

    live: bool = False
    flight: int = 0
    goal: Vector | None = None
    speed: str = "slow"
    fresh_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Trouble:
    """Why the arm holds until a person acknowledges it, in the words of the command line.

    Attributes:
        message: What happened.
        hint: What to do now.
    """

    message: str
    hint: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Talk:
    """A calibration under way.

    Attributes:
        wizard: Where the conversation is; None while the arm still holds itself.
        complaint: Why the last answer did not do.
        warnings: What saving would lose, and what the servos' own limits would cut off.
        saved_at: The file, once it is saved.
    """

    wizard: Wizard | None
    complaint: str = ""
    warnings: tuple[str, ...] = ()
    saved_at: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Readout:
    """What the pilot last saw.

    Attributes:
        measured: Where the joints are (n,), rad or m.
        goals: Where the servos were told to go (n,); None while they follow nobody.
        states: What the servos report, a little older.
        trouble: Why the arm holds, if it does.
        ended: The last flight that is over.
        notes: What the arm said besides, the oldest first.
        talk: The calibration under way, if any.
    """

    measured: Vector
    goals: Vector | None = None
    states: tuple[JointState, ...] = ()
    trouble: Trouble | None = None
    ended: int = 0
    notes: tuple[str, ...] = ()
    talk: Talk | None = None
