"""Scripted input of a calibration."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from itertools import repeat
from pathlib import Path

from ikservo.calibration.procedure import (
    CalibrationStage,
    CalibrationState,
    blocking_issues,
    range_complete,
)
from ikservo.errors import BadValueError, CalibrationError, FileFormatError
from ikservo.files.reading import read_text

__all__ = ["ANSWERS", "ScriptedAnswers", "apply_answer", "read_script"]

ANSWERS = {
    "accept": "take the pose, end the sweep, or save",
    "undo": "undo the last answer",
    "again JOINT": "measure a joint again",
    "skip JOINT": "use the arm file's range and sign of a joint",
    "free JOINT": "a joint has no end stops",
}

_MAX_SCRIPT_BYTES = 64 * 1024
_UNCHANGED_S = 1.0  # without a new extreme, once every range looks whole
_COMPLETE_AFTER_S = 4.0  # likewise, where ranges are narrower than the arm file's
_TIMEOUT_S = 60.0


def apply_answer(wizard: CalibrationState, text: str) -> CalibrationState:
    """Return the state after an input.

    Raises:
        BadValueError: It is no valid input.
        UnknownNameError: The arm has no joint of that name.
        CalibrationError: Something is missing before it can be accepted; names it.
    """
    verb, _, joint = text.strip().partition(" ")
    if joint and verb in ("again", "skip", "free"):
        steps = {"again": wizard.remeasure, "skip": wizard.skip, "free": wizard.mark_continuous}
        return steps[verb](joint.strip())
    if text.strip() == "accept":
        return wizard.accept()
    if text.strip() == "undo":
        return wizard.undo()
    raise BadValueError("The answer", repr(text), f"one of: {', '.join(ANSWERS)}")


def read_script(path: Path) -> list[str]:
    """Return the inputs in a file, one a line; ``#`` begins a comment.

    Raises:
        FileFormatError: The file cannot be read, or a line is no valid input.
    """
    verbs = {text.partition(" ")[0] for text in ANSWERS}
    entries: list[str] = []
    for number, line in enumerate(read_text(path, _MAX_SCRIPT_BYTES).splitlines(), start=1):
        text = line.partition("#")[0].strip()
        if text and text.partition(" ")[0] not in verbs:
            expected = f"one of: {', '.join(ANSWERS)}"
            raise FileFormatError(path, f"line {number}", "is not an answer", expected)
        entries += [text] if text else []
    return entries


class ScriptedAnswers:
    """Supplies inputs one after the other, each when it is due.

    ``accept`` waits until the arm is held still, or until no range has grown for a while; all other
    inputs wait for the sweep.

    Args:
        answers: In order; None to accept whatever can be accepted.
    """

    def __init__(self, entries: Iterable[str] | None = None) -> None:
        self._entries: Iterator[str] = repeat("accept") if entries is None else iter(entries)
        self._next = deque([next(self._entries, "")])
        self._last: tuple[object, ...] = ()
        self._since_s: float | None = None

    def next_answer(self, wizard: CalibrationState, at_s: float) -> str | None:
        """Return the next input if it is due.

        Raises:
            CalibrationError: It was not due for a minute without changes; names the cause.
        """
        unchanged_s = self._unchanged_for_s(wizard, at_s)
        text = self._next[0]
        if text and self._is_due(text, wizard, unchanged_s):
            self._next[0] = next(self._entries, "")
            self._since_s = None
            return text
        if unchanged_s > _TIMEOUT_S:
            raise self._timeout_error(wizard)
        return None

    def _unchanged_for_s(self, wizard: CalibrationState, at_s: float) -> float:
        """Return how long nothing has changed, seconds."""
        present = (
            wizard.stage,
            wizard.current_joint,
            *((t.low, t.high) for t in wizard.tracks.values()),
        )
        if self._since_s is None or present != self._last:
            self._last, self._since_s = present, at_s
        return at_s - self._since_s

    def _is_due(self, text: str, wizard: CalibrationState, unchanged_s: float) -> bool:
        if text != "accept":
            return wizard.stage is CalibrationStage.SWEEP
        if wizard.stage is CalibrationStage.REFERENCE_POSE:
            return wizard.is_at_rest
        if wizard.stage is CalibrationStage.SWEEP:
            complete = all(range_complete(wizard, subject) for subject in wizard.subjects)
            return unchanged_s > (_UNCHANGED_S if complete else _COMPLETE_AFTER_S) and not any(
                blocking_issues(wizard)
            )
        return True

    def _timeout_error(self, wizard: CalibrationState) -> CalibrationError:
        if wizard.stage is CalibrationStage.REFERENCE_POSE:
            return CalibrationError(
                "Timeout: the arm was not held still.", "Hold it still in the pose."
            )
        if not self._next[0]:
            return CalibrationError("The script ended before the calibration did.", "Add: accept")
        return next(blocking_issues(wizard), CalibrationError("Timeout: no motion for 60 s."))
