"""The conversation of a calibration: readings and answers go in, until there is a review."""

from __future__ import annotations

import sys
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

from ikservo.arm.calibrating.by_hand import LooseArm
from ikservo.calibration.sweeping.answers import Script, apply, read_script
from ikservo.calibration.sweeping.obstacles import goes_round, obstacles
from ikservo.calibration.sweeping.sweep import Stage, Wizard
from ikservo.cli.calibrating.screen import Screen
from ikservo.cli.keyboard import Keys, keys
from ikservo.errors import CalibrationError, InputError

__all__ = ["Answers", "answers", "converse"]


class Answers(Protocol):
    """Who answers: a person, a script, or nobody but patience."""

    def answer(self, wizard: Wizard, at_s: float) -> str | None:
        """Return the next answer, if there is one now."""
        ...


def converse(
    loose: LooseArm,
    wizard: Wizard,
    who: Answers,
    screen: Screen,
    stages: Sequence[Stage] = (Stage.ANCHOR, Stage.SWEEP),
) -> Wizard:
    """Read the servos and take answers as long as the conversation is at one of some stages.

    Raises:
        CalibrationError: Nobody is there to mend what is missing.
        BusError: The servos went silent.
    """
    while wizard.stage in stages:
        reading = loose.read()
        if reading is None:
            continue
        wizard = wizard.read(*reading)
        screen.show(wizard)
        word = who.answer(wizard, reading[0])
        if word:
            wizard = _answered(wizard, word, who, screen)
    return wizard


def _answered(wizard: Wizard, word: str, who: Answers, screen: Screen) -> Wizard:
    try:
        screen.tell("")
        return apply(wizard, word)
    except CalibrationError as error:
        if not isinstance(who, _Keyboard):
            raise
        screen.tell(f"{error.message} {error.command_hint}")
        return wizard


@contextmanager
def answers(script: Path | None, *, yes: bool, ask: bool) -> Generator[Answers]:
    """Yield who answers.

    Args:
        script: A file of answers, if any.
        yes: Whether everything acceptable is accepted.
        ask: Whether a person may be asked.

    Raises:
        InputError: Nobody is there; names the options that answer instead.
    """
    if script:
        yield Script(read_script(script))
    elif yes:
        yield Script()
    elif ask and sys.stdin.isatty():
        with keys() as key:
            yield _Keyboard(key)
    else:
        raise InputError(
            "Cannot ask: input is not a terminal.", "Give --yes, or --from-script FILE."
        )


class _Keyboard:
    """A person at the keys; what they mean stands on the screen."""

    def __init__(self, key: Keys) -> None:
        self._key = key

    def answer(self, wizard: Wizard, at_s: float) -> str | None:
        """Return what the first of the keys pressed since the last reading means here."""
        key = self._key()[:1].lower()
        if key in ("\n", "\r"):
            return "accept"
        if key == "u":
            return "undo"
        verbs = {"s": "skip", "r": "again", "f": "free"}
        if key in verbs and wizard.stage is Stage.SWEEP:
            joint = _meant(wizard, key)
            return f"{verbs[key]} {joint}" if joint else None
        return None


def _meant(wizard: Wizard, key: str) -> str:
    """Return the joint that a key is about: the asked one, else the first that is not right."""
    if key == "f":
        round_joints = [s.name for s in wizard.subjects if goes_round(wizard, s)]
        return next((name for name in round_joints if name not in wizard.free), "")
    if wizard.asked:
        return wizard.asked.name
    complaint = next(obstacles(wizard), None)
    names = [s.name for s in wizard.subjects if complaint and s.name in complaint.message]
    return next(iter(names), "")
