"""What a person says during a touch-off, as words; from keys, a script or mere patience."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from itertools import repeat
from pathlib import Path

from ikservo.errors import BadValueError, CalibrationError, FileFormatError
from ikservo.files.reading import read_text
from ikservo.model.touch.conversation import Touching

__all__ = ["WORDS", "TouchScript", "apply", "read_touch_script"]

WORDS = ("touch", "skip", "undo", "accept")

_LARGEST_BYTES = 64 * 1024
_PATIENCE_S = 60.0


def apply(talk: Touching, word: str) -> Touching:
    """Return the conversation after an answer.

    Raises:
        BadValueError: It is no answer.
        CalibrationError: It cannot be said now; says why.
    """
    steps = {"touch": talk.touch, "skip": talk.skip, "undo": talk.undo, "accept": talk.accept}
    if word not in steps:
        raise BadValueError("The answer", repr(word), f"one of: {', '.join(WORDS)}")
    return steps[word]()


def read_touch_script(path: Path) -> list[str]:
    """Return the answers in a file, one a line; ``#`` begins a remark.

    Raises:
        FileFormatError: The file cannot be read, or a line is no answer.
    """
    answers: list[str] = []
    for number, line in enumerate(read_text(path, _LARGEST_BYTES).splitlines(), start=1):
        word = line.partition("#")[0].strip()
        if word and word not in WORDS:
            expected = f"one of: {', '.join(WORDS)}"
            raise FileFormatError(path, f"line {number}", "is not an answer", expected)
        answers += [word] if word else []
    return answers


class TouchScript:
    """Gives answers one after the other, each when its moment has come.

    ``touch`` waits until the arm has been moved since the last one and is held still.

    Args:
        answers: In order; None to touch every point and accept.
    """

    def __init__(self, answers: Iterable[str] | None = None) -> None:
        self._patient = answers is None
        self._answers: Iterator[str] = repeat("") if answers is None else iter(answers)
        self._next = deque([next(self._answers, "accept")])
        self._since_s: float | None = None

    def answer(self, talk: Touching, at_s: float) -> str | None:
        """Return the next answer if its moment has come.

        Raises:
            CalibrationError: It has not come for a minute.
        """
        self._since_s = at_s if self._since_s is None else self._since_s
        word = ("touch" if talk.asked else "accept") if self._patient else self._next[0]
        if word != "touch" or talk.asked is None or (talk.still and talk.moved):
            self._next[0] = next(self._answers, "accept")
            self._since_s = at_s
            return word
        if at_s - self._since_s > _PATIENCE_S:
            raise CalibrationError(
                f"Timeout: the tip was not put on {talk.asked.name} within 60 s.",
                "Guide the tip there and keep it still.",
            )
        return None
