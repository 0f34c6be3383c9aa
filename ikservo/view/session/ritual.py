"""A calibration driven from the page: the same conversation as on a terminal, answered by words."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator
from dataclasses import replace
from datetime import UTC, datetime

from ikservo.arm.calibrating.by_hand import LooseArm, loose_arm
from ikservo.arm.calibrating.filing import lost_by_saving
from ikservo.calibration.sweeping.answers import apply
from ikservo.calibration.sweeping.sweep import Stage, Wizard
from ikservo.errors import CalibrationError, InputError
from ikservo.model import Model
from ikservo.view.session.readout import Talk

__all__ = ["POSE", "Ritual"]

POSE = "rest"


class Ritual:
    """Holds calibrations of one arm on one port.

    Args:
        model: The arm.
        port: Its port; the arm itself must not hold it meanwhile.
        pose: The named pose that it is held in at first.

    Attributes:
        wanted: Whether there shall be a calibration now.
    """

    def __init__(self, model: Model, port: str | None, pose: str = POSE) -> None:
        self.model, self._port, self.pose = model, port, pose
        self._answers: deque[str] = deque(maxlen=8)
        self.wanted = False

    def begin(self) -> None:
        """Want a calibration; safe from any thread."""
        self._answers.clear()
        self.wanted = True

    def answer(self, word: str) -> None:
        """Say a word of ``ikservo.calibration.sweeping.answers``; safe from any thread.

        Besides, ``leave`` ends it, and ``protect`` saves and has the servos hold the limits, too.
        """
        if word == "leave":
            self.wanted = False
        self._answers.append(word)

    def hold(self) -> Generator[Talk]:
        """Yield the state of the conversation at each reading until the person leaves.

        Raises:
            IkservoError: The servos do not answer, or nothing could be saved.
        """
        try:
            with loose_arm(self.model, self._port) as loose:
                yield from self._until_let_go(loose)
                yield from self._converse(loose)
        finally:
            self.wanted = False

    def _until_let_go(self, loose: LooseArm) -> Generator[Talk]:
        """Let the arm go limp, once the person says that it is held."""
        while self.wanted and loose.holding():
            yield Talk(None)
            if self._next() == "accept":
                loose.let_go()
            loose.read()

    def _converse(self, loose: LooseArm) -> Generator[Talk]:
        talk = Talk(Wizard.begin(loose.subjects(self.pose)))
        while self.wanted and talk.wizard is not None:
            reading = loose.read()
            wizard = talk.wizard
            if reading is not None and wizard.stage in (Stage.ANCHOR, Stage.SWEEP):
                talk = replace(talk, wizard=wizard.read(*reading))
            talk = self._answered(loose, talk)
            yield talk

    def _answered(self, loose: LooseArm, talk: Talk) -> Talk:
        word, wizard = self._next(), talk.wizard
        if not word or wizard is None or not wizard.tracks:
            return talk
        protect = word == "protect" and wizard.stage is Stage.REVIEW
        try:
            after = apply(wizard, "accept" if protect else word)
        except (CalibrationError, InputError) as error:
            return replace(talk, complaint=f"{error.message} {error.command_hint}")
        if after.stage is Stage.SAVED and wizard.stage is Stage.REVIEW:
            return Talk(after, saved_at=self._save(loose, wizard, protect=protect))
        return self._reviewed(loose, after) if after.stage is Stage.REVIEW else Talk(after)

    def _reviewed(self, loose: LooseArm, wizard: Wizard) -> Talk:
        """Return the review, with the warnings that the command line gives."""
        try:
            outcome = loose.conclude(wizard, self.pose, datetime.now(UTC))
        except CalibrationError as error:
            return Talk(wizard, complaint=f"{error.message} {error.command_hint}")
        warnings = (*lost_by_saving(loose), *loose.cut_by_servos(outcome))
        return Talk(wizard, warnings=warnings)

    def _next(self) -> str:
        return self._answers.popleft() if self._answers else ""

    def _save(self, loose: LooseArm, wizard: Wizard, *, protect: bool) -> str:
        now = datetime.now(UTC)
        return str(loose.save(loose.conclude(wizard, self.pose, now, write_limits=protect)))
