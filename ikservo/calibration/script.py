"""Scripted answers to the questions of a calibration."""

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
_QUIET_S = 1.0  # without a new extreme, once every range looks whole
_COMPLETE_AFTER_S = 4.0  # likewise, where ranges are narrower than the arm file's
_TIMEOUT_S = 60.0


def apply_answer(wizard: CalibrationState, word: str) -> CalibrationState:
    """Return the conversation after an answer.

    Raises:
        BadValueError: It is no answer.
        UnknownNameError: It names no joint of this arm.
        CalibrationError: Something is missing before it can be accepted; says what.
    """
    verb, _, joint = word.strip().partition(" ")
    if joint and verb in ("again", "skip", "free"):
        steps = {"again": wizard.remeasure, "skip": wizard.skip, "free": wizard.mark_continuous}
        return steps[verb](joint.strip())
    if word.strip() == "accept":
        return wizard.accept()
    if word.strip() == "undo":
        return wizard.undo()
    raise BadValueError("The answer", repr(word), f"one of: {', '.join(ANSWERS)}")


def read_script(path: Path) -> list[str]:
    """Return the answers in a file, one a line; ``#`` begins a remark.

    Raises:
        FileFormatError: The file cannot be read, or a line is no answer.
    """
    verbs = {word.partition(" ")[0] for word in ANSWERS}
    answers: list[str] = []
    for number, line in enumerate(read_text(path, _MAX_SCRIPT_BYTES).splitlines(), start=1):
        word = line.partition("#")[0].strip()
        if word and word.partition(" ")[0] not in verbs:
            expected = f"one of: {', '.join(ANSWERS)}"
            raise FileFormatError(path, f"line {number}", "is not an answer", expected)
        answers += [word] if word else []
    return answers


class ScriptedAnswers:
    """Gives answers one after the other, each when its moment has come.

    ``accept`` waits until the arm is held still, or until nothing new has been found for a while;
    everything else waits for the sweep.

    Args:
        answers: In order; None to accept whatever can be accepted.
    """

    def __init__(self, answers: Iterable[str] | None = None) -> None:
        self._answers: Iterator[str] = repeat("accept") if answers is None else iter(answers)
        self._next = deque([next(self._answers, "")])
        self._seen: tuple[object, ...] = ()
        self._since_s: float | None = None

    def next_answer(self, wizard: CalibrationState, at_s: float) -> str | None:
        """Return the next answer if its moment has come.

        Raises:
            CalibrationError: It has not come for a minute in which nothing changed; says why.
        """
        calm_s = self._unchanged_for_s(wizard, at_s)
        word = self._next[0]
        if word and self._is_due(word, wizard, calm_s):
            self._next[0] = next(self._answers, "")
            self._since_s = None
            return word
        if calm_s > _TIMEOUT_S:
            raise self._timeout_error(wizard)
        return None

    def _unchanged_for_s(self, wizard: CalibrationState, at_s: float) -> float:
        """Return for how long nothing new has been found."""
        seen = (
            wizard.stage,
            wizard.current_joint,
            *((t.low, t.high) for t in wizard.tracks.values()),
        )
        if self._since_s is None or seen != self._seen:
            self._seen, self._since_s = seen, at_s
        return at_s - self._since_s

    def _is_due(self, word: str, wizard: CalibrationState, calm_s: float) -> bool:
        if word != "accept":
            return wizard.stage is CalibrationStage.SWEEP
        if wizard.stage is CalibrationStage.REFERENCE_POSE:
            return wizard.is_at_rest
        if wizard.stage is CalibrationStage.SWEEP:
            whole = all(range_complete(wizard, subject) for subject in wizard.subjects)
            return calm_s > (_QUIET_S if whole else _COMPLETE_AFTER_S) and not any(
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
