"""A dialogue with a user as values: notices, questions, requests, and their answers.

A dialogue is a generator. It yields a `Notice`, a `Progress`, a `Question`, a `HandRequest` or an
`Entry`, and receives a word such as ``accept``, or None as long as there is no answer. It contains
all texts and is independent of terminal, page and file: a terminal
(`ikservo.cli.terminal_dialogue`), the page (`ikservo.apps.page.running.calibration_panel`) and a
script (`ScriptedAnswers`) answer the same values.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from types import MappingProxyType
from typing import TypeAlias, TypeVar

from ikservo.calibration.uncalibrated_joint import JointUnderCalibration
from ikservo.errors import CalibrationError, FileFormatError, IkservoError
from ikservo.files.reading import read_text

ACCEPT = "accept"

_MAX_SCRIPT_BYTES = 64 * 1024
_TIMEOUT_S = 60.0


class JointProgress(Enum):
    """Progress of a joint."""

    UNMOVED = "not moved yet"
    MOVING = ""
    COMPLETE = "✓"
    FREE = "✓ turns freely"
    SKIPPED = "skipped"
    KNOWN = "✓ from LeRobot"


@dataclass(frozen=True, slots=True)
class JointReadout:
    """Position, recorded range and expected range of one joint.

    Positions are rad or m.
    """

    subject: JointUnderCalibration
    state: JointProgress
    position: float
    low: float
    high: float

    @property
    def name(self) -> str:
        """The joint's name."""
        return self.subject.name


@dataclass(frozen=True, slots=True)
class Choice:
    """An answer that is possible now.

    Attributes:
        answer: The word for the answer, as used in a script.
        label: A few words on the effect; empty if the answer need not be offered.
        key: The key on a terminal; empty if there is none.
        wait_s: The time without a change after which a script gives this answer; None if the answer
            is not possible yet.
        joints: The joints, one of which must be named after the word; empty if no joint is named.
        joint: The joint to which the key refers; empty if there is none now.
    """

    answer: str
    label: str = ""
    key: str = ""
    wait_s: float | None = 0.0
    joints: tuple[str, ...] = ()
    joint: str = ""


@dataclass(frozen=True, slots=True)
class Notice:
    """A line that is shown once and needs no answer.

    Attributes:
        text: The line.
        joint: The joint whose servo must be plugged in; empty if the line asks for none.
    """

    text: str
    joint: str = ""


@dataclass(frozen=True, slots=True)
class Progress:
    """The present activity; the next ``Progress`` replaces it.

    Attributes:
        text: The activity.
        done: The part of the work that is done, in any unit.
        total: The whole work, in the same unit; 0 if that is not known.
        elapsed_s: The time since the work began; 0 if the remaining time cannot be estimated.
    """

    text: str
    done: float = 0.0
    total: float = 0.0
    elapsed_s: float = 0.0

    def __str__(self) -> str:
        share = f"{100.0 * self.done / self.total:.0f} %" if self.total else ""
        return ", ".join(filter(None, (self.text, share, self.left)))

    @property
    def left(self) -> str:
        """The remaining time, in words; empty if it cannot be estimated."""
        if not (self.total and self.done and self.elapsed_s):
            return ""
        left_s = self.elapsed_s / self.done * (self.total - self.done)
        return f"about {max(left_s, 0.0):.0f} s left"


class Unasked(Enum):
    """The answer to a question if nobody can be asked."""

    YES = "yes"
    NO = "no"
    NEEDS_YES = "yes with --yes or a script; otherwise no"
    ERROR = "yes with --yes; otherwise an error that names this option"


@dataclass(frozen=True, slots=True)
class Question:
    """A question whose answer is ``accept`` for yes and any other word for no.

    Attributes:
        text: The question.
        unasked: The answer if nobody can be asked.
        stage: The part of the dialogue to which the question belongs.
        label: A few words on the effect of ``accept``.
        more: Additional answers, for an interface with buttons.
    """

    text: str
    unasked: Unasked
    stage: str = ""
    label: str = "yes"
    more: tuple[Choice, ...] = ()

    def offers(self, answer: str | None) -> bool:
        """Check whether a word is ``accept`` or one of the additional answers."""
        return answer in (ACCEPT, *(choice.answer for choice in self.more))


@dataclass(frozen=True, slots=True)
class Entry:
    """A question answered by a word or a value; the answer is the typed text.

    Attributes:
        text: The question.
        option: The command-line option that answers the question beforehand.
        default: The answer if the user only presses Enter or nobody can be asked; empty if an
            answer is required.
        choices: The possible answers; empty if any text is allowed.
    """

    text: str
    option: str
    default: str = ""
    choices: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class HandRequest:
    """A task for the user with the limp arm; yielded again with each reading of its servos.

    Attributes:
        stage: The part of the dialogue to which the request belongs.
        step: The progress of the dialogue, such as ``Step 2 of 9``.
        text: The task of the user.
        at_s: The time of the reading.
        choices: The possible answers; the first is given if there is no script and no user.
        progress: Values that change when the user does something.
        missing: The error if the user does nothing for a minute.
        readings: The joints to show while they are moved; None if there are none.
        current: The name of the joint to move; empty if it may be any joint.
        ticks: The unwrapped tick of each servo, by id.
        error: The error that refused the last answer, until the next answer; None if it was
            accepted.
    """

    stage: str
    step: str
    text: str
    at_s: float
    choices: tuple[Choice, ...]
    progress: tuple[object, ...]
    missing: CalibrationError
    readings: tuple[JointReadout, ...] | None = None
    current: str = ""
    ticks: Mapping[int, int] = field(default_factory=dict[int, int])
    error: IkservoError | None = None

    @property
    def line(self) -> str:
        """The step and the task."""
        return f"{self.step}: {self.text}" if self.step else self.text

    @property
    def error_text(self) -> str:
        """The reason why the last answer was refused, and the remedy; empty if it was accepted."""
        return f"{self.error.message} {self.error.command_hint}" if self.error else ""


Result = TypeVar("Result")
Dialogue: TypeAlias = Generator[Notice | Progress | Question | HandRequest, str | None, Result]
EntryDialogue: TypeAlias = Generator[
    Notice | Progress | Question | Entry | HandRequest, str | None, Result
]
"""A dialogue that also asks for words and values; every `Dialogue` is also an `EntryDialogue`."""


class ScriptedAnswers:
    """Answers requests in sequence, each after its waiting time.

    Args:
        entries: The answers in order; None gives the first choice of every request.
    """

    def __init__(self, entries: Iterable[str] | None = None) -> None:
        self._entries = None if entries is None else deque(entries)
        self._last: tuple[object, ...] = ()
        self._since_s: float | None = None

    def next_answer(self, request: HandRequest) -> str | None:
        """Return the next answer if its waiting time is over.

        Raises:
            CalibrationError: Nothing changed for a minute, and no answer was due.
        """
        if self._since_s is None or request.progress != self._last:
            self._last, self._since_s = request.progress, request.at_s
        unchanged_s = request.at_s - self._since_s
        if self._entries is None:
            entry = request.choices[0].answer
        else:
            entry = self._entries[0] if self._entries else ""
        verb = entry.partition(" ")[0]
        wait_s = next((each.wait_s for each in request.choices if each.answer == verb), None)
        if wait_s is not None and (wait_s == 0.0 or unchanged_s > wait_s):
            if self._entries:
                self._entries.popleft()
            self._since_s = None
            return entry
        if unchanged_s <= _TIMEOUT_S:
            return None
        if not entry:
            raise CalibrationError(
                "The script ended before the calibration was complete.", "Add this line: accept"
            )
        raise request.missing


def read_answers(
    path: Path, known: Sequence[str], former: Mapping[str, str] = MappingProxyType({})
) -> list[str]:
    """Read the answers from a file, one per line; ``#`` begins a comment.

    ``known`` are the possible answers; a second word in an answer means any name. ``former`` maps
    each old word for an answer to its new word.

    Raises:
        FileFormatError: The file cannot be read, or a line is not an answer.
    """
    takes_name = {text.partition(" ")[0]: " " in text for text in known}
    answers: list[str] = []
    for number, line in enumerate(read_text(path, _MAX_SCRIPT_BYTES).splitlines(), start=1):
        verb, _, name = line.partition("#")[0].strip().partition(" ")
        verb = former.get(verb, verb)
        if verb and (verb not in takes_name or (name and not takes_name[verb])):
            expected = f"one of: {', '.join(known)}"
            raise FileFormatError(path, f"line {number}", "is not an answer", expected)
        answers += [f"{verb} {name.strip()}".strip()] if verb else []
    return answers
