"""What a person says during a calibration, as words; from keys, a script or mere patience."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from itertools import repeat
from pathlib import Path

from ikservo.calibration.sweeping.obstacles import complete, obstacles
from ikservo.calibration.sweeping.sweep import Stage, Wizard
from ikservo.errors import BadValueError, CalibrationError, FileFormatError
from ikservo.files.reading import read_text

__all__ = ["WORDS", "Script", "apply", "read_script"]

WORDS = {
    "accept": "take the pose, end the sweep, or save",
    "undo": "undo the last answer",
    "again JOINT": "measure a joint again",
    "skip JOINT": "use the arm file's range and sign of a joint",
    "free JOINT": "a joint has no end stops",
}

_LARGEST_BYTES = 64 * 1024
_CALM_S = 1.0  # without a new extreme, once every range looks whole
_ENOUGH_S = 4.0  # likewise, where ranges are narrower than the arm file's
_PATIENCE_S = 60.0


def apply(wizard: Wizard, word: str) -> Wizard:
    """Return the conversation after an answer.

    Raises:
        BadValueError: It is no answer.
        UnknownNameError: It names no joint of this arm.
        CalibrationError: Something is missing before it can be accepted; says what.
    """
    verb, _, joint = word.strip().partition(" ")
    if joint and verb in ("again", "skip", "free"):
        steps = {"again": wizard.again, "skip": wizard.skip, "free": wizard.turns_freely}
        return steps[verb](joint.strip())
    if word.strip() == "accept":
        return wizard.accept()
    if word.strip() == "undo":
        return wizard.undo()
    raise BadValueError("The answer", repr(word), f"one of: {', '.join(WORDS)}")


def read_script(path: Path) -> list[str]:
    """Return the answers in a file, one a line; ``#`` begins a remark.

    Raises:
        FileFormatError: The file cannot be read, or a line is no answer.
    """
    verbs = {word.partition(" ")[0] for word in WORDS}
    answers: list[str] = []
    for number, line in enumerate(read_text(path, _LARGEST_BYTES).splitlines(), start=1):
        word = line.partition("#")[0].strip()
        if word and word.partition(" ")[0] not in verbs:
            expected = f"one of: {', '.join(WORDS)}"
            raise FileFormatError(path, f"line {number}", "is not an answer", expected)
        answers += [word] if word else []
    return answers


class Script:
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

    def answer(self, wizard: Wizard, at_s: float) -> str | None:
        """Return the next answer if its moment has come.

        Raises:
            CalibrationError: It has not come for a minute in which nothing changed; says why.
        """
        calm_s = self._calm_s(wizard, at_s)
        word = self._next[0]
        if word and self._ready(word, wizard, calm_s):
            self._next[0] = next(self._answers, "")
            self._since_s = None
            return word
        if calm_s > _PATIENCE_S:
            raise self._stuck(wizard)
        return None

    def _calm_s(self, wizard: Wizard, at_s: float) -> float:
        """Return for how long nothing new has been found."""
        seen = (wizard.stage, wizard.asked, *((t.low, t.high) for t in wizard.tracks.values()))
        if self._since_s is None or seen != self._seen:
            self._seen, self._since_s = seen, at_s
        return at_s - self._since_s

    def _ready(self, word: str, wizard: Wizard, calm_s: float) -> bool:
        if word != "accept":
            return wizard.stage is Stage.SWEEP
        if wizard.stage is Stage.ANCHOR:
            return wizard.still
        if wizard.stage is Stage.SWEEP:
            whole = all(complete(wizard, subject) for subject in wizard.subjects)
            return calm_s > (_CALM_S if whole else _ENOUGH_S) and not any(obstacles(wizard))
        return True

    def _stuck(self, wizard: Wizard) -> CalibrationError:
        if wizard.stage is Stage.ANCHOR:
            return CalibrationError(
                "Timeout: the arm was not held still.", "Hold it still in the pose."
            )
        if not self._next[0]:
            return CalibrationError("The script ended before the calibration did.", "Add: accept")
        return next(obstacles(wizard), CalibrationError("Timeout: no motion for 60 s."))
