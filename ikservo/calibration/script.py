"""Scripted input of a calibration."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Generic, TypeVar

from ikservo.calibration.procedure import (
    CalibrationStage,
    CalibrationState,
    blocking_issues,
    range_complete,
)
from ikservo.errors import BadValueError, CalibrationError, FileFormatError
from ikservo.files.reading import read_text

__all__ = [
    "ANSWERS",
    "AnswerScript",
    "ScriptedAnswers",
    "apply_answer",
    "read_entries",
    "read_script",
]

State = TypeVar("State")


ANSWERS = {
    "accept": "take the pose, end the sweep, or save",
    "undo": "undo the last answer",
    "remeasure JOINT": "measure a joint again",
    "skip JOINT": "use the arm file's range and sign of a joint",
    "continuous JOINT": "a joint has no end stops",
}
_FORMER_VERBS = {"again": "remeasure", "free": "continuous"}

_MAX_SCRIPT_BYTES = 64 * 1024
_UNCHANGED_S = 1.0  # without a new extreme, once every range looks whole
_COMPLETE_AFTER_S = 4.0  # likewise, where ranges are narrower than the arm file's
_TIMEOUT_S = 60.0


def apply_answer(state: CalibrationState, text: str) -> CalibrationState:
    """Return the state after an input.

    Raises:
        BadValueError: It is no valid input.
        UnknownNameError: The arm has no joint of that name.
        CalibrationError: Something is missing before it can be accepted; names it.
    """
    verb, _, joint = text.strip().partition(" ")
    verb = _FORMER_VERBS.get(verb, verb)
    steps = {
        "remeasure": state.remeasure, "skip": state.skip, "continuous": state.mark_continuous,
    }  # fmt: skip
    if joint and verb in steps:
        return steps[verb](joint.strip())
    if text.strip() == "accept":
        return state.accept()
    if text.strip() == "undo":
        return state.undo()
    raise BadValueError("The answer", repr(text), f"one of: {', '.join(ANSWERS)}")


def read_script(path: Path) -> list[str]:
    """Return the inputs in a file, one a line; ``#`` begins a comment.

    Raises:
        FileFormatError: The file cannot be read, or a line is no valid input.
    """
    return read_entries(path, tuple(ANSWERS), _FORMER_VERBS)


def read_entries(
    path: Path, known: Sequence[str], former: Mapping[str, str] = MappingProxyType({})
) -> list[str]:
    """Return the inputs in a file, one a line; ``#`` begins a comment.

    Args:
        path: The file.
        known: The valid inputs; a second word stands for any name.
        former: Former first words, which are still accepted, with the current ones.

    Raises:
        FileFormatError: The file cannot be read, or a line is no valid input.
    """
    verbs = {text.partition(" ")[0]: " " in text for text in known}  # to: whether a name follows
    entries: list[str] = []
    for number, line in enumerate(read_text(path, _MAX_SCRIPT_BYTES).splitlines(), start=1):
        text = line.partition("#")[0].strip()
        verb, _, rest = text.partition(" ")
        verb = former.get(verb, verb)
        if text and (verb not in verbs or (rest and not verbs[verb])):
            expected = f"one of: {', '.join(known)}"
            raise FileFormatError(path, f"line {number}", "is not an answer", expected)
        entries += [text] if text else []
    return entries


class AnswerScript(ABC, Generic[State]):
    """Supplies inputs one after the other, each when it is due.

    Args:
        entries: In order; None for the default input of every state.

    Attributes:
        final_entry: The input after the last one of a script; none if empty.
    """

    final_entry = ""

    def __init__(self, entries: Iterable[str] | None = None) -> None:
        self._entries = None if entries is None else deque(entries)
        self._last: tuple[object, ...] = ()
        self._since_s: float | None = None

    def next_answer(self, state: State, at_s: float) -> str | None:
        """Return the next input if it is due.

        Raises:
            CalibrationError: It was not due for a minute without changes; names the cause.
        """
        unchanged_s = self._unchanged_for_s(state, at_s)
        text = self._next_entry(state)
        if text and self.is_due(text, state, unchanged_s):
            if self._entries:
                self._entries.popleft()
            self._since_s = None
            return text
        if unchanged_s > _TIMEOUT_S:
            raise self.timeout_error(text, state)
        return None

    def _next_entry(self, state: State) -> str:
        if self._entries is None:
            return self.default_entry(state)
        return self._entries[0] if self._entries else self.final_entry

    def _unchanged_for_s(self, state: State, at_s: float) -> float:
        """Return how long nothing has changed, seconds."""
        present = self.progress(state)
        if self._since_s is None or present != self._last:
            self._last, self._since_s = present, at_s
        return at_s - self._since_s

    @abstractmethod
    def default_entry(self, state: State) -> str:
        """Return the input of a state where there is no script."""

    @abstractmethod
    def progress(self, state: State) -> tuple[object, ...]:
        """Return values that differ where something has changed."""

    @abstractmethod
    def is_due(self, text: str, state: State, unchanged_s: float) -> bool:
        """Return whether an input is due in a state that has not changed for a while."""

    @abstractmethod
    def timeout_error(self, text: str, state: State) -> CalibrationError:
        """Return why an input was not due in time."""


class ScriptedAnswers(AnswerScript[CalibrationState]):
    """Supplies the inputs of a calibration by hand.

    ``accept`` waits until the arm is held still, or until no range has grown for a while; all other
    inputs wait for the sweep. Without a script everything is accepted.
    """

    def default_entry(self, state: CalibrationState) -> str:
        """Return the input of a state where there is no script."""
        return "accept"

    def progress(self, state: CalibrationState) -> tuple[object, ...]:
        """Return stage, joint and measured ranges."""
        ranges = ((track.low, track.high) for track in state.tracks.values())
        return (state.stage, state.current_joint, *ranges)

    def is_due(self, text: str, state: CalibrationState, unchanged_s: float) -> bool:
        """Return whether an input is due in a state that has not changed for a while."""
        if text != "accept":
            return state.stage is CalibrationStage.SWEEP
        if state.stage is CalibrationStage.REFERENCE_POSE:
            return state.is_at_rest
        if state.stage is CalibrationStage.SWEEP:
            complete = all(range_complete(state, subject) for subject in state.subjects)
            return unchanged_s > (_UNCHANGED_S if complete else _COMPLETE_AFTER_S) and not any(
                blocking_issues(state)
            )
        return True

    def timeout_error(self, text: str, state: CalibrationState) -> CalibrationError:
        """Return why an input was not due in time."""
        if state.stage is CalibrationStage.REFERENCE_POSE:
            return CalibrationError(
                "Timeout: the arm was still moving.", "Hold it still in the pose."
            )
        if not text:
            return CalibrationError("The script ended before the calibration did.", "Add: accept")
        return next(blocking_issues(state), CalibrationError("Timeout: no motion for 60 s."))
