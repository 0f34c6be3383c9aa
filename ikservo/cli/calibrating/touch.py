"""``ikservo calibrate --touch``: the tip is put on known points, and the arm learns its links."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Protocol

from ikservo.arm.calibrating.by_hand import LooseArm, loose_arm
from ikservo.arm.calibrating.touching import TouchArm
from ikservo.cli.calibrating.meeting import consent, greet, let_go, telling_what_is_left
from ikservo.cli.calibrating.touch_findings import fields, findings
from ikservo.cli.calibrating.touch_points import read_points
from ikservo.cli.keyboard import Keys, keys
from ikservo.cli.output import note, point, print_json, print_lines
from ikservo.errors import CalibrationError, IkservoError, InputError
from ikservo.model import Model
from ikservo.model.touch import Estimate
from ikservo.model.touch.answers import TouchScript, apply, read_touch_script
from ikservo.model.touch.conversation import Touching
from ikservo.model.touch.grid import Place, sheet

__all__ = ["TouchWishes", "touch_off"]

_REPEATS = 20
_KEYS = {"\n": "touch", "\r": "touch", "s": "skip", "u": "undo", "a": "accept"}


@dataclass(frozen=True, slots=True)
class TouchWishes:
    """What the command line asks of a touch-off.

    Attributes:
        points: A file of points; None for the printed sheet.
        same_point: Whether one point that nobody has measured is touched again and again.
        edge_m: Where the near edge of the sheet lies, metres straight ahead; None for where the
            middle of the sheet is beneath the tool of the pose ``home``.
        block_m: The height of a block that stands at every other cross; None for none.
    """

    points: Path | None = None
    same_point: bool = False
    edge_m: float | None = None
    block_m: float | None = None


class _Answers(Protocol):
    def answer(self, talk: Touching, at_s: float) -> str | None:
        """Return the next answer, if there is one now."""
        ...


def touch_off(
    model: Model,
    port: str | None,
    wishes: TouchWishes,
    script: Path | None,
    *,
    yes: bool,
    asks: bool,
    json: bool,
) -> None:
    """Hold the conversation, show what it says, and save it where it helps.

    Raises:
        CalibrationError: The arm is not calibrated, the touches say too little, or nothing of
            what they say helps.
        InputError: Nobody is there to answer.
    """
    answers = read_touch_script(script) if script else None
    with loose_arm(model, port) as loose:
        arm = TouchArm(loose)
        places = arm.within_reach(_places(model, wishes))
        let_go(loose, asks=asks, yes=yes or script is not None)
        with telling_what_is_left():
            greet(loose, "home")
            talk = _conversed(loose, arm.begin(places), answers, yes=yes, asks=asks)
            found = _reviewed(talk, asks=asks)
            path = arm.save(found, datetime.now(UTC))
    if json:
        print_json("touch-off", path=path, **fields(talk, found))
    else:
        print_lines([f"Saved to {path}"])


def _reviewed(talk: Touching, *, asks: bool) -> Estimate:
    """Show what the touches say, and ask whether to save it.

    Raises:
        CalibrationError: It is no improvement.
        IkservoError: The person said no.
    """
    found = talk.found
    assert found is not None  # noqa: S101  # only accepting ends a conversation
    for line in findings(talk, found):
        note(f"  {line}")
    if not found.improves:
        raise CalibrationError(
            "Touch-off did not improve the calibration; nothing was saved.",
            "Touch more points, further apart and in more different postures.",
        )
    if not consent("Save this?", default=True, asks=asks):
        raise IkservoError("Cancelled; nothing was saved, torque is off.")
    return found


def _places(model: Model, wishes: TouchWishes) -> list[Place]:
    """Return what shall be touched, and say where the sheet must lie."""
    if wishes.same_point:
        note("Put the tip on one fixed point again and again, each time in another posture.")
        return [Place("the point") for _ in range(_REPEATS)]
    if wishes.points:
        return read_points(wishes.points)
    edge_m, places = sheet(model, wishes.edge_m, wishes.block_m)
    note(
        f"Lay the sheet docs/touch-grid.svg flat in front of the arm, its near edge "
        f"{edge_m * 1000:.0f} mm from the base's origin, its arrow pointing away from the arm."
    )
    return places


def _conversed(
    loose: LooseArm, talk: Touching, answers: list[str] | None, *, yes: bool, asks: bool
) -> Touching:
    """Read the servos and take answers until the touches have been reviewed."""
    scripted = yes or answers is not None
    if not scripted and not (asks and sys.stdin.isatty()):
        raise InputError(
            "Cannot ask: input is not a terminal.", "Give --yes, or --from-script FILE."
        )
    said = ""
    with nullcontext() if scripted else keys() as key:
        who: _Answers = TouchScript(answers) if key is None else _Keyboard(key)
        while talk.found is None:
            reading = loose.read_reported()
            if reading is None:
                continue
            talk = talk.read(*reading)
            said = _told(_task(talk), said)
            word = who.answer(talk, reading[0])
            talk = _answered(talk, word, scripted=scripted) if word else talk
    return talk


def _answered(talk: Touching, word: str, *, scripted: bool) -> Touching:
    try:
        return apply(talk, word)
    except CalibrationError as error:
        if scripted:
            raise
        note(f"{error.message} {error.command_hint}")
        return talk


def _told(line: str, said: str) -> str:
    if line != said:
        note(line)
    return line


def _task(talk: Touching) -> str:
    done = len(talk.touches)
    if talk.asked is None:
        return f"{done} points touched.  a evaluate   u undo   Ctrl-C stop"
    where = talk.asked.position_m
    place = "" if where is None else f" at {point(where.tolist())}"
    keys = f"Enter   s skip   u undo{'   a evaluate' if talk.enough else ''}   Ctrl-C stop"
    number = f"Point {done + 1} of {done + len(talk.places)}"
    return f"{number}: put the tip on {talk.asked.name}{place}.\n  {keys}"


class _Keyboard:
    """A person at the keys."""

    def __init__(self, key: Keys) -> None:
        self._key = key

    def answer(self, talk: Touching, at_s: float) -> str | None:
        """Return what the first of the keys pressed since the last reading means here."""
        return _KEYS.get(self._key()[:1].lower())
