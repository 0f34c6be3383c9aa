"""How every calibration begins: the person agrees, the arm goes limp, everybody is named."""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator
from contextlib import contextmanager

import typer

from ikservo.arm.calibrating.by_hand import LooseArm
from ikservo.arm.calibrating.sketch import sketch
from ikservo.cli.output import note
from ikservo.cli.prompts import confirm
from ikservo.errors import IkservoError, StoppedError
from ikservo.files.writing import check_writable

__all__ = ["consent", "greet", "let_go", "telling_what_is_left"]


def consent(question: str, *, default: bool, asks: bool) -> bool:
    """Ask for yes or no; return the default where nobody may be asked."""
    return confirm(question) if asks else default


def let_go(loose: LooseArm, *, asks: bool, yes: bool) -> None:
    """Switch torque off, once the person knows.

    Raises:
        FileWriteError: No calibration could be saved afterwards.
        IkservoError: Servos hold the arm and nobody agreed; nothing was changed.
    """
    for path in (loose.path, loose.journal_path):
        check_writable(path.parent)
    if loose.settled:
        note(loose.settled)
    holding = loose.holding()
    if holding:
        note("Torque will be switched off; support the arm.")
        if not yes and not consent("Switch torque off?", default=False, asks=asks):
            raise IkservoError("Cancelled; nothing changed.", "Without asking: --yes")
    loose.let_go()


@contextmanager
def telling_what_is_left() -> Generator[None]:
    """Say, where Ctrl-C ends a calibration by hand, that it left nothing behind.

    Raises:
        StoppedError: In place of Ctrl-C or the end of the input.
    """
    try:
        yield
    except (KeyboardInterrupt, typer.Abort):
        raise StoppedError("Stopped: nothing was saved; torque is off.") from None


def greet(loose: LooseArm, pose: str) -> None:
    """Say who is on the line, and show the pose."""
    servos = list(loose.facts.values())
    counts = Counter(facts.table.model_name for facts in servos)
    listed = ", ".join(f"{count} {name}" for name, count in counts.items())
    firmware = ", ".join(sorted({facts.firmware for facts in servos}))
    note(f"{loose.model.title} on {loose.bus.port.name}: {listed}, firmware {firmware}.")
    for line in sketch(loose.model, loose.model.joints[-1].name, pose)[:-1]:
        note(f"    {line}")
